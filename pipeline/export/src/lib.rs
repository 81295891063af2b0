//! luxel-export
