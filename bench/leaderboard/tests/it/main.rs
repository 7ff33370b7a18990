//! Leaderboards from outside: what is submitted, checked and shown.

mod fixtures;
mod hostile;
mod own;
mod pages;
mod submissions;
