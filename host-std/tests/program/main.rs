//! The program `myactuator`, run as its users run it.

mod cli;
mod demo;
mod held_up;
mod motors;
mod question;
mod readme;
mod run;
mod sim_control;
mod sim_log;
mod sim_robot;
mod sim_serve;
