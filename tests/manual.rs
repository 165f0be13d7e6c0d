//! What the manual says that a drive does, sentence by sentence, a module a subject; and whether the
//! list of its requirements, in `requirements/`, is whole and true.
//!
//! The documentation of each test gives the section of its sentence and its meaning. Motor of the
//! drives here: ideal, 0.02 kg·m², 2 N·m/A, friction 0.05 N·m·s; rated current 6 A, stall current
//! 12 A; 16384 pulses, gear 6.

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
