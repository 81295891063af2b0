//! Whether a verified lightmap is good enough: the RMSE certainly within the limit, and every check passed.

use std::fmt;

use luxel_export::Report;
use luxel_export::report::{Check, Place, Verification};

use super::{GROWTH, MOST, Verified, Verify, is_quiet};
use crate::text::plain;

/// What a report says to a request.
#[derive(Clone, Debug, PartialEq)]
pub enum Answer {
    /// It holds no verification, or one of fewer texels or paths than it takes; with how many texels there are.
    Insufficient {
        texels: u64,
    },
    Passed,
    Refused(Box<Refusal>),
}

/// Why a lightmap is not good enough.
#[derive(Clone, Debug, PartialEq)]
pub struct Refusal {
    /// The largest RMSE that passes, as a share of the mean irradiance.
    pub limit: f64,
    pub verified: Verified,
}

/// Judges a report that was written before. Where the limit lies within the interval of fewer texels than may be drawn,
/// more of them have to be; where the reference's noise was small enough for what was asked then and is not for what is
/// asked now, more paths.
pub fn answer(report: &Report, ask: &Verify) -> Answer {
    let Some(verification) = &report.verification else { return Answer::Insufficient { texels: 0 } };
    let v = verification;
    let wanted = ask.fewest();
    if v.nothing.is_none() && v.drawn < wanted.min(v.available) {
        return Answer::Insufficient { texels: v.drawn };
    }
    let is_noisy = !is_quiet(v.reference_noise, v.rmse, ask.max_error) && v.paths < u64::from(MOST);
    if v.nothing.is_none() && is_noisy {
        return Answer::Insufficient { texels: v.drawn };
    }
    let Some(limit) = ask.max_error else { return Answer::Passed };
    let is_open = v.nothing.is_none() && v.rmse_low <= limit && v.rmse_high > limit;
    if is_open && v.drawn < v.available && 2 * v.drawn <= GROWTH * wanted {
        return Answer::Insufficient { texels: v.drawn };
    }
    let verified = Verified { verification: verification.clone(), checks: report.checks.clone() };
    verified.judge(limit).map_or(Answer::Passed, |refusal| Answer::Refused(Box::new(refusal)))
}

impl Verified {
    /// Why it is not good enough for a limit, if it is not.
    pub fn judge(&self, limit: f64) -> Option<Refusal> {
        let is_exact = self.verification.nothing.is_some() || self.verification.rmse_high <= limit;
        let passes = is_exact && self.checks.iter().all(|check| check.passed);
        (!passes).then(|| Refusal { limit, verified: self.clone() })
    }
}

impl fmt::Display for Refusal {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        let Verified { verification: v, checks } = &self.verified;
        let mut parts = Vec::new();
        if v.nothing.is_none() && v.rmse_high > self.limit {
            parts.push(exceeded(v, self.limit));
        }
        parts.extend(checks.iter().filter(|check| !check.passed).map(told));
        write!(f, "the lightmap is not good enough: {}", parts.join("; "))
    }
}

/// What is said of an RMSE that is not certainly within the limit.
fn exceeded(v: &Verification, limit: f64) -> String {
    if v.texels == 0 {
        return "no texel can be compared, because none that a chart covers by half is in the open; more texels \
                (--size, --texel-density) have some"
            .into();
    }
    let is_sure = v.rmse_low > limit;
    let mut text = format!(
        "the error is {} and {} {}",
        rmse(v),
        if is_sure { "certainly above" } else { "not certainly within" },
        percent(limit)
    );
    if let (Some(direct), Some(indirect)) = (&v.direct, &v.indirect) {
        text += &format!(" (direct light {}, other light {})", percent(direct.rmse), percent(indirect.rmse));
    }
    let worst: Vec<String> = v.worst.iter().take(3).map(place).collect();
    if !worst.is_empty() {
        text += &format!("; worst: {}", worst.join(", "));
    }
    text += match is_sure {
        true => "; a finer preset (--preset final), smaller voxels (--voxels) or a finer gather (--cut-error) help",
        false if v.drawn >= v.available => {
            "; all texels were compared, so only a finer bake (--preset final) decides it"
        }
        false => "; more texels decide it (--verify)",
    };
    text
}

/// RMSE with its interval: `1.20 % (1.02 to 1.45 %, 400 texels)`.
pub fn rmse(v: &Verification) -> String {
    let low = format!("{:.2}", 100.0 * v.rmse_low);
    let high = if v.rmse_high < 1e3 { percent(v.rmse_high) } else { "any value".into() };
    format!("{} of the mean irradiance (95 %: {low} to {high}, {} texels)", percent(v.rmse), v.texels)
}

/// What was found, in a line for a person.
pub fn line(v: &Verification) -> String {
    if let Some(why) = &v.nothing {
        return format!("verified: there is nothing to compare, because {}", plain(why));
    }
    format!(
        "verified: RMSE {}, bias {:+.2} %, median {}, p95 {}; reference noise {} by {} paths a texel",
        rmse(v),
        100.0 * v.bias,
        percent(v.median),
        percent(v.p95),
        percent(v.reference_noise),
        v.paths
    )
}

/// A check, for a person.
pub fn told(check: &Check) -> String {
    format!("{}: {}", plain(&check.name), plain(&check.message))
}

fn place(place: &Place) -> String {
    let mean = |light: [f64; 3]| light.iter().sum::<f64>() / 3.0;
    format!(
        "{} at {}: {:.4} lx, expected {:.4}",
        plain(&place.object),
        point(place.position),
        mean(place.found),
        mean(place.expected)
    )
}

/// A position for a person.
pub fn point([x, y, z]: [f64; 3]) -> String {
    format!("({x:.3}, {y:.3}, {z:.3})")
}

fn percent(share: f64) -> String {
    format!("{:.2} %", 100.0 * share)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn report(drawn: u64, [low, value, high]: [f64; 3]) -> Report {
        let verification = Verification {
            drawn,
            texels: drawn,
            available: 5000,
            rmse: value,
            rmse_low: low,
            rmse_high: high,
            ..Verification::default()
        };
        let check = Check { name: "leaks".into(), passed: true, ..Check::default() };
        Report { verification: Some(verification), checks: vec![check], ..Report::default() }
    }

    fn ask(texels: u32, max_error: Option<f64>) -> Verify {
        Verify { texels, max_error }
    }

    #[test]
    fn a_gate_passes_what_is_certainly_good_and_nothing_else() {
        let good = report(400, [0.01, 0.012, 0.015]);
        assert_eq!(answer(&good, &ask(400, Some(0.015))), Answer::Passed);
        assert_eq!(answer(&good, &ask(500, None)), Answer::Insufficient { texels: 400 });
        assert_eq!(answer(&good, &ask(200, None)), Answer::Passed);
        assert_eq!(answer(&Report::default(), &ask(1, None)), Answer::Insufficient { texels: 0 });
        let Answer::Refused(refusal) = answer(&good, &ask(400, Some(0.005))) else { panic!() };
        let said = refusal.to_string();
        assert!(
            said.contains("1.20 %") && said.contains("1.00 to 1.50 %") && said.contains("certainly above"),
            "{said}"
        );
    }

    #[test]
    fn what_is_open_needs_more_texels_until_they_are_enough() {
        let open = |drawn| answer(&report(drawn, [0.01, 0.012, 0.015]), &ask(400, Some(0.013)));
        assert_eq!(open(400), Answer::Insufficient { texels: 400 });
        assert_eq!(open(800), Answer::Insufficient { texels: 800 });
        let Answer::Refused(refusal) = open(1600) else { panic!() };
        assert!(refusal.to_string().contains("not certainly within 1.30 %"), "{refusal}");
        let mut all = report(400, [0.01, 0.012, 0.015]);
        all.verification.as_mut().unwrap().available = 400;
        let Answer::Refused(refusal) = answer(&all, &ask(400, Some(0.013))) else { panic!() };
        assert!(refusal.to_string().contains("all texels were compared"), "{refusal}");
    }

    #[test]
    fn noise_that_was_small_enough_for_another_limit_is_measured_anew() {
        let noisy = |paths| {
            let mut noisy = report(400, [0.0, 0.01, 0.06]);
            let v = noisy.verification.as_mut().unwrap();
            (v.paths, v.reference_noise) = (paths, 0.07);
            noisy
        };
        assert_eq!(answer(&noisy(256), &ask(400, Some(0.3))), Answer::Passed);
        assert_eq!(answer(&noisy(256), &ask(400, Some(0.02))), Answer::Insufficient { texels: 400 });
        assert_eq!(answer(&noisy(256), &ask(400, None)), Answer::Insufficient { texels: 400 });
        // More paths than that are not walked.
        assert_eq!(answer(&noisy(MOST.into()), &ask(400, None)), Answer::Passed);
    }

    #[test]
    fn where_no_texel_can_be_compared_nothing_is_good_enough() {
        let nothing = Verification { rmse_high: f64::MAX, ..Verification::default() };
        let unknown = Report { verification: Some(nothing), ..Report::default() };
        let Answer::Refused(refusal) = answer(&unknown, &ask(400, Some(0.5))) else { panic!() };
        assert!(refusal.to_string().contains("no texel can be compared"), "{refusal}");
    }

    #[test]
    fn a_failed_check_refuses_and_nothing_to_compare_passes() {
        let mut bad = report(400, [0.01, 0.012, 0.015]);
        bad.checks[0] = Check { passed: false, message: "three\nof them".into(), ..bad.checks[0].clone() };
        assert_eq!(answer(&bad, &ask(400, None)), Answer::Passed);
        let Answer::Refused(refusal) = answer(&bad, &ask(400, Some(0.5))) else { panic!() };
        assert!(refusal.to_string().contains("leaks: \"three\\nof them\""), "{refusal}");
        let nothing = Verification { nothing: Some("the scene has no light".into()), ..Verification::default() };
        let dark = Report { verification: Some(nothing.clone()), ..Report::default() };
        assert_eq!(answer(&dark, &ask(400, Some(0.01))), Answer::Passed);
        assert!(line(&nothing).contains("no light"));
    }
}
