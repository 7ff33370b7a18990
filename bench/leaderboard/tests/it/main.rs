//! Leaderboards from outside: what is submitted, checked and shown.

mod fixtures;
mod hostile;
mod pages;
mod submissions;
