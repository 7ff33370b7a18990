//! `bench` from outside, as it is typed: one program, so that it is linked once.

mod broken;
mod cli;
mod command;
mod cues;
mod devices;
mod downloaded;
mod figures;
mod fixtures;
mod forms;
mod input_forms;
mod latency;
mod latex;
mod leaderboard;
mod npy;
mod ownership;
mod predict;
mod processes;
mod report;
mod rows;
mod runs;
mod runtimes;
mod study;
#[cfg(unix)]
mod workflow;
mod world;
mod wrong_numbers;
