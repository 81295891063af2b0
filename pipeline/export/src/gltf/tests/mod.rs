//! Whole .glb files: written, reread, compared with what they came from.

mod hostile;
mod kit;
mod scenes;
mod shapes;
mod survival;
