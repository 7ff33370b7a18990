//! Leaderboards from outside: what is submitted, checked and shown.

mod browser;
mod fixtures;
mod hostile;
mod own;
mod pages;
mod submissions;
