//! One scene per file.

pub mod colonnade;
pub mod cornell;
pub mod many_lamps;
pub mod textured_room;
pub mod two_rooms;
