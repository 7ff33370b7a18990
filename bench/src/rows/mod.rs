//! Work on rows alone, without models or data: paired tests ([`compare`]) and leaderboards
//! ([`leaderboard`]).

pub mod compare;
pub mod leaderboard;
