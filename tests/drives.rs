//! The simulated drive: its motor, what it answers and does, alone and in a fleet.

mod drives {
    mod fleet;
    mod loads;
    mod loops;
    mod mechanics;
    mod plant_loads;
    mod plant_physics;
    mod quirks;
    mod rates;
    mod robots;
    mod runs;
}
