//! The simulated drive, alone and in a fleet: its motor, its answers and its actions.

mod drives {
    mod backlash;
    mod cogging;
    mod derating;
    mod encoders;
    mod energy;
    mod fleet;
    mod housing;
    mod loads;
    mod loops;
    mod mechanics;
    mod models;
    mod plant_loads;
    mod plant_physics;
    mod quirks;
    mod rates;
    mod responses;
    mod robots;
    mod runs;
    mod two_links;
}
