//! One measurement, and a table of them as CSV.

use serde::{Deserialize, Serialize};

use super::Score;

/// One way to find the light of a scene, with its cost and its error.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Point {
    pub scene: String,
    /// What the points of a row differ in: a setting, `together`, or a method's own amount of work.
    pub series: String,
    pub method: String,
    /// The value of what the series is about, as it is written.
    pub value: String,
    /// The same as a number that grows with the work; 0 where it is none.
    pub x: f64,
    /// Texels at which light was found.
    pub texels: u64,
    pub surfels: u64,
    /// Of light alone: neither import nor unwrap nor export.
    pub seconds: f64,
    /// What of it belongs to texels, and grows with their number.
    pub texel_seconds: f64,
    /// All of it, of all processors together.
    pub cpu_seconds: f64,
    pub continuous_rays: u64,
    pub discrete_rays: u64,
    /// Paths a texel of the reference.
    pub reference_paths: u32,
    pub score: Score,
}

/// The columns of the CSV, which are explained in its first lines.
const COLUMNS: [(&str, &str); 29] = [
    ("scene", "name of the scene"),
    ("series", "what the points of the row differ in"),
    ("method", "how light was found"),
    ("value", "the value of what the series is about"),
    ("x", "the same as a number that grows with the work"),
    ("texels", "texels at which light was found"),
    ("surfels", "voxel patches"),
    ("seconds", "wall clock, light alone"),
    ("texel_seconds", "what of it belongs to texels"),
    ("cpu_seconds", "all of it, of all processors"),
    ("continuous_rays", "rays against triangles, photons and next events included"),
    ("discrete_rays", "surfels times directions, over all bounces"),
    ("reference_paths", "paths a texel of the reference"),
    ("mean_lux", "mean irradiance of the reference"),
    ("reference_noise", "root mean square of the reference's standard error, over the mean"),
    ("rmse", "over the mean, all bands, the reference's noise taken off"),
    ("rmse_low", "its 95 % confidence interval"),
    ("rmse_high", "the same; empty where nothing was compared"),
    ("relmse", "mean of squared error over squared light"),
    ("bias", "mean difference over the mean"),
    ("bias_low", "its 95 % confidence interval"),
    ("bias_high", "the same"),
    ("median", "of the relative error, the reference's noise included"),
    ("p95", "95th percentile of the relative error, the reference's noise included"),
    ("direct_rmse", "of light straight from lights, over the mean of all, noise taken off"),
    ("direct_bias", "the same"),
    ("indirect_rmse", "of reflected and sky light, over the mean of all, noise taken off"),
    ("indirect_bias", "the same"),
    ("seconds_per_texel", "cpu_seconds over texels"),
];

impl Point {
    fn row(&self) -> [String; COLUMNS.len()] {
        let s = &self.score;
        // What no texel tells has no upper end.
        let short = |x: f64| if x < f64::MAX { format!("{x:.6}") } else { String::new() };
        [
            self.scene.clone(),
            self.series.clone(),
            self.method.clone(),
            self.value.clone(),
            self.x.to_string(),
            self.texels.to_string(),
            self.surfels.to_string(),
            format!("{:.3}", self.seconds),
            format!("{:.3}", self.texel_seconds),
            format!("{:.3}", self.cpu_seconds),
            self.continuous_rays.to_string(),
            self.discrete_rays.to_string(),
            self.reference_paths.to_string(),
            format!("{:.6e}", s.mean),
            short(s.noise),
            short(s.rmse),
            short(s.rmse_low),
            short(s.rmse_high),
            short(s.relmse),
            short(s.bias),
            short(s.bias_low),
            short(s.bias_high),
            short(s.median),
            short(s.p95),
            short(s.direct_rmse),
            short(s.direct_bias),
            short(s.indirect_rmse),
            short(s.indirect_bias),
            format!("{:.3e}", self.cpu_seconds / self.texels.max(1) as f64),
        ]
    }
}

/// A table with `notes` and the meaning of its columns as comments ahead of it.
pub fn csv(points: &[Point], notes: &[String]) -> Result<Vec<u8>, csv::Error> {
    let mut text = String::new();
    for note in notes {
        text += &format!("# {}\n", note.replace('\n', " "));
    }
    for (name, meaning) in COLUMNS {
        text += &format!("# {name}: {meaning}\n");
    }
    let mut table = csv::Writer::from_writer(text.into_bytes());
    table.write_record(COLUMNS.map(|(name, _)| name))?;
    for point in points {
        table.write_record(point.row())?;
    }
    table.into_inner().map_err(|e| csv::Error::from(e.into_error()))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_not_known_is_left_blank() {
        let score = Score { rmse_high: f64::MAX, ..Score::default() };
        assert_eq!(Point { score, ..Point::default() }.row()[17], "");
    }

    #[test]
    fn a_table_is_read_by_whoever_skips_comments() {
        let point = Point { scene: "a, \"b\"".into(), value: "side:8".into(), texels: 7, ..Point::default() };
        let bytes = csv(&[point.clone(), point], &["made by\nhand".into()]).unwrap();
        assert!(bytes.starts_with(b"# made by hand\n# scene: "));
        let mut reader = csv::ReaderBuilder::new().comment(Some(b'#')).from_reader(&bytes[..]);
        assert_eq!(reader.headers().unwrap().len(), COLUMNS.len());
        let rows: Vec<_> = reader.records().collect::<Result<_, _>>().unwrap();
        assert_eq!((rows.len(), &rows[1][0], &rows[0][5]), (2, "a, \"b\"", "7"));
    }
}
