//! Notices on their way into the scene: many faults of one kind become a few messages and a count.

use std::collections::BTreeMap;

use crate::Notice;

/// Messages of one code that are shown in full.
const SHOWN: usize = 12;

/// Collects notices; what a file can cause any number of times stays readable.
#[derive(Default)]
pub struct Notes {
    notices: Vec<Notice>,
    count: BTreeMap<&'static str, usize>,
}

impl Notes {
    pub fn add(&mut self, code: &'static str, message: impl Into<String>) {
        let count = self.count.entry(code).or_default();
        *count += 1;
        if *count <= SHOWN {
            self.notices.push(Notice { code, message: message.into() });
        }
    }

    /// All notices in the order in which they came up, with a last one per code for what was only counted.
    pub fn finish(mut self) -> Vec<Notice> {
        for (code, count) in self.count {
            if count > SHOWN {
                let message = format!("{} more notices of the kind `{code}`", count - SHOWN);
                self.notices.push(Notice { code, message });
            }
        }
        self.notices
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_flood_of_notices_is_counted() {
        let mut notes = Notes::default();
        for i in 0..100 {
            notes.add("flood", format!("drop {i}"));
        }
        notes.add("other", "one");
        let notices = notes.finish();
        assert_eq!(notices.len(), SHOWN + 2);
        assert_eq!(notices.last().unwrap().message, "88 more notices of the kind `flood`");
    }
}
