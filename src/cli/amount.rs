//! Sizes, times and shares on the command line.

use std::time::Duration;

/// Units of size [bytes], the longer names first where one ends like another.
const SIZES: [(&str, u64); 9] = [
    ("kib", 1 << 10),
    ("mib", 1 << 20),
    ("gib", 1 << 30),
    ("tib", 1 << 40),
    ("kb", 1_000),
    ("mb", 1_000_000),
    ("gb", 1_000_000_000),
    ("tb", 1_000_000_000_000),
    ("b", 1),
];

/// Units of time [s].
const TIMES: [(&str, u64); 5] = [("s", 1), ("m", 60), ("h", 3600), ("d", 86_400), ("w", 604_800)];

/// `2GiB`, `1.5 GB`, `65536`: a number of bytes.
pub fn size(text: &str) -> Result<u64, String> {
    let is_plain = !text.is_empty() && text.bytes().all(|b| b.is_ascii_digit());
    let plain = if is_plain { text.parse().ok() } else { None };
    plain.or_else(|| amount(text, &SIZES)).ok_or_else(|| "expected a size such as 500MB, 2.5GiB or 0".into())
}

/// `30d`, `12h`: a length of time. A number alone says too little.
pub fn time(text: &str) -> Result<Duration, String> {
    let seconds =
        value(text, &TIMES).ok_or_else(|| "expected a time such as 90s, 0.5s, 45m, 12h, 30d or 2w".to_owned());
    seconds.map(Duration::from_secs_f64)
}

/// `2%`, `0.02`: a share above 0. A number from 1 on without its sign may mean either.
pub fn share(text: &str) -> Result<f64, String> {
    let text = text.trim();
    let (number, unit) = match text.strip_suffix('%') {
        Some(number) => (number.trim_end(), 0.01),
        None => (text, 1.0),
    };
    let value = number.parse::<f64>().ok().map(|x| x * unit);
    let fits = |x: &f64| x.is_finite() && *x > 0.0 && (unit < 1.0 || *x < 1.0);
    value.filter(fits).ok_or_else(|| "expected a share such as 2%, 0.5% or 0.02".into())
}

/// A whole number of these units.
fn amount(text: &str, units: &[(&str, u64)]) -> Option<u64> {
    value(text, units).map(|value| value as u64)
}

/// A number with one of these units.
fn value(text: &str, units: &[(&str, u64)]) -> Option<f64> {
    let text = text.trim().to_ascii_lowercase();
    let (number, unit) = units.iter().find_map(|(name, unit)| Some((text.strip_suffix(name)?.trim_end(), *unit)))?;
    let is_number = number.bytes().all(|b| b.is_ascii_digit() || b == b'.');
    let value = number.parse::<f64>().ok().filter(|_| is_number)? * unit as f64;
    // Beyond this, f64 counts no single units, and nobody has such a disk or waits so long.
    (value <= (1u64 << 53) as f64).then_some(value)
}

/// Bytes for a person: `0 B`, `640 KiB`, `1.5 GiB`.
pub fn bytes(count: u64) -> String {
    let units = [("TiB", 1u64 << 40), ("GiB", 1 << 30), ("MiB", 1 << 20), ("KiB", 1 << 10)];
    match units.iter().find(|(_, unit)| count >= *unit) {
        None => format!("{count} B"),
        Some((name, unit)) => {
            let value = count as f64 / *unit as f64;
            if value < 10.0 { format!("{value:.1} {name}") } else { format!("{value:.0} {name}") }
        }
    }
}

/// How long ago, for a person: `20 s`, `5 min`, `3 h`, `12 days`.
pub fn ago(time: Duration) -> String {
    match time.as_secs() {
        seconds @ 0..60 => format!("{seconds} s"),
        seconds @ 60..3600 => format!("{} min", seconds / 60),
        seconds @ 3600..172_800 => format!("{} h", seconds / 3600),
        seconds => format!("{} days", seconds / 86_400),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn shares_are_told_with_their_sign() {
        for (text, value) in [("2%", 0.02), ("0.5 %", 0.005), ("0.02", 0.02), ("150%", 1.5)] {
            assert!((share(text).unwrap() - value).abs() < 1e-12, "{text}");
        }
        for wrong in ["2", "0", "0%", "-1%", "nan", "inf%", "%", "", "much"] {
            assert!(share(wrong).is_err(), "{wrong}");
        }
    }

    #[test]
    fn sizes_and_times_are_read_with_their_units() {
        let sizes = ["0", "65536", "2GiB", "1.5 gib", "500MB", "10kb", "3 B", "0.5KiB"].map(size);
        assert_eq!(sizes, [0, 65536, 2 << 30, 3 << 29, 500_000_000, 10_000, 3, 512].map(Ok));
        let times = ["90s", "45m", "12h", "30d", "2w", "0.5 d"].map(time);
        assert_eq!(times, [90, 2700, 43_200, 2_592_000, 1_209_600, 43_200].map(|s| Ok(Duration::from_secs(s))));
        assert_eq!(time("0.5s"), Ok(Duration::from_millis(500)));
        for wrong in [
            "",
            "GiB",
            "-1",
            "-1GiB",
            "nanGiB",
            "1e3MB",
            "infB",
            "2 G B",
            "99999999TiB",
            "1.2.3MB",
            "99999999999999999999",
        ] {
            assert!(size(wrong).is_err(), "{wrong}");
        }
        for wrong in ["", "d", "30", "30 parsecs", "-1d", "1e9d", "999999999999999w"] {
            assert!(time(wrong).is_err(), "{wrong}");
        }
    }

    #[test]
    fn amounts_read_well() {
        let said = [0, 1023, 1024, 650_000, 5 << 30, 40 << 40].map(bytes);
        assert_eq!(said, ["0 B", "1023 B", "1.0 KiB", "635 KiB", "5.0 GiB", "40 TiB"]);
        let said = [0, 59, 60, 7200, 172_799, 864_000].map(|s| ago(Duration::from_secs(s)));
        assert_eq!(said, ["0 s", "59 s", "1 min", "2 h", "47 h", "10 days"]);
    }
}
