//! Work on rows alone, without models or data: paired tests ([`compare`]), leaderboards
//! ([`leaderboard`]) and what a study of several seeds says ([`study`]).

pub mod compare;
pub mod leaderboard;
pub mod study;
