//! The bytes on the wires: the frames, their fields and the manual's examples.

mod frames {
    mod any_bytes;
    mod fields;
    mod manual_vectors;
    mod motion_packing;
    mod rs485_receiver;
    mod table;
    mod values;
}
