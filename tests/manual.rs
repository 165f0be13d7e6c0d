//! What a drive does by the manual, sentence by sentence, with a module for each subject. Also checks that the list of
//! requirements in `requirements/` is complete and true.
//!
//! The documentation of each test has the section and the meaning of its sentence. The motor of these drives: ideal,
//! 0.02 kg·m², 2 N·m/A, friction 0.05 N·m·s; rated current 6 A, stall current 12 A; 16384 pulses, gear 6.

mod manual {
    mod buses;
    mod commands;
    mod errors;
    mod functions;
    mod motion;
    mod readings;
    mod requirements;
    mod stored;
    mod system;
}
