//! Why outputs are stale, in words and as stable words for programs.

use std::fmt;
use std::path::PathBuf;

use serde_json::{Value as Json, json};

use crate::text::{cut, shown};

/// Why a scene's outputs are not what a bake would write now.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Reason {
    /// There is no report where the outputs go.
    Unbaked,
    /// It was, as a draft alone.
    Draft,
    /// The report does not tell what it should.
    Report {
        what: String,
    },
    /// Luxel, one of its stages, or the form of its store.
    Version {
        of: String,
        was: String,
        is: String,
    },
    Setting {
        name: String,
        was: String,
        is: String,
    },
    /// An input has other bytes.
    InputChanged {
        path: PathBuf,
    },
    /// An input cannot be read any more, or the scene's name for it leads elsewhere.
    InputGone {
        path: PathBuf,
    },
    /// A file can be read that could not be then.
    InputNew {
        path: PathBuf,
    },
    OutputMissing {
        path: PathBuf,
    },
    /// An output has other bytes than were written: somebody changed it, or another bake is just replacing it.
    OutputChanged {
        path: PathBuf,
    },
    /// The outputs are those of an export that weighed the light groups anew.
    Mixed,
    /// The report holds no verification, or one of so many texels, and one of more is asked for.
    Unverified {
        texels: u64,
    },
    /// The settings for an error are wanted, and nobody has tried them.
    Untried,
    /// An image of another bake under this scene's name.
    LeftOver {
        path: PathBuf,
    },
}

impl Reason {
    /// A stable word for programs.
    pub fn code(&self) -> &'static str {
        match self {
            Self::Unbaked => "not-baked",
            Self::Draft => "draft",
            Self::Report { .. } => "report-unreadable",
            Self::Version { .. } => "version-changed",
            Self::Setting { .. } => "setting-changed",
            Self::InputChanged { .. } => "input-changed",
            Self::InputGone { .. } => "input-gone",
            Self::InputNew { .. } => "input-new",
            Self::OutputMissing { .. } => "output-missing",
            Self::OutputChanged { .. } => "output-changed",
            Self::Mixed => "mixed",
            Self::Unverified { .. } => "not-verified",
            Self::Untried => "not-tried",
            Self::LeftOver { .. } => "output-left-over",
        }
    }

    /// `code` and `message`.
    pub fn to_json(&self) -> Json {
        json!({ "code": self.code(), "message": self.to_string() })
    }
}

impl fmt::Display for Reason {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        match self {
            Self::Unbaked => f.write_str("it has not been baked to this place yet"),
            Self::Draft => f.write_str("its outputs are a draft"),
            Self::Report { what } => write!(f, "the report cannot be read: {}", cut(what)),
            Self::Version { of, was, is } if of == "luxel" => {
                write!(f, "it was baked by luxel {}, and this is {}", cut(was), cut(is))
            }
            Self::Version { of, was, is } => {
                write!(f, "{} has version {} now and had {}", cut(of), cut(is), cut(was))
            }
            Self::Setting { name, was, is } => {
                write!(f, "the setting {} was {} and is {}", cut(name), cut(was), cut(is))
            }
            Self::InputChanged { path } => write!(f, "{} has changed", shown(path)),
            Self::InputGone { path } => write!(f, "{} was read and is not there any more", shown(path)),
            Self::InputNew { path } => write!(f, "{} can be read now and was missing", shown(path)),
            Self::OutputMissing { path } => write!(f, "the output {} is not there", shown(path)),
            Self::OutputChanged { path } => write!(f, "the output {} is not as it was written", shown(path)),
            Self::Mixed => write!(f, "its light groups were weighed anew by luxel export"),
            Self::Untried => f.write_str("the settings for its target error are not known yet"),
            Self::Unverified { texels: 0 } => f.write_str("its error was not measured"),
            Self::Unverified { texels } => {
                write!(f, "its error was measured at {texels} texels, too few of them or by too few paths to judge it")
            }
            Self::LeftOver { path } => write!(f, "{} was left over by another bake", shown(path)),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn words_of_a_report_cannot_break_a_message() {
        let setting = |was: &str| Reason::Setting { name: "sky".into(), was: was.into(), is: "none".into() };
        assert_eq!(setting("noon.hdr").to_string(), "the setting sky was noon.hdr and is none");
        assert_eq!(setting("a\n\u{1b}[2J").to_string(), "the setting sky was \"a\\n\\u{1b}[2J\" and is none");
        let long = setting(&"ö".repeat(100_000)).to_string();
        assert!(long.chars().count() < 400 && long.contains('…'), "{long}");
        assert_eq!(setting("x").to_json()["code"], "setting-changed");
    }
}
