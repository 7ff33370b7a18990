//! Leaderboards that people host with a git repository and static pages: what a submission is, its
//! check from its own rows, ranking, and the pages.
//!
//! [`board`] is the folder, [`init`] lays one out, [`publish`] writes a submission, [`check`] derives
//! all of them again. The definition of a line is `strat_metrics::leaderboard`'s, and what may be
//! ranked is PROTOCOL 12. Nothing here runs a model, needs a data set or knows a network.

pub mod board;
pub mod card;
pub mod check;
pub mod init;
pub mod publish;
pub mod published;
mod rows;
pub mod run;
pub mod section;
pub mod show;
pub mod site;
pub mod submission;
mod text;
pub mod web;
