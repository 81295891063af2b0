//! luxel
