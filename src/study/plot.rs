//! Plots of error against cost, both on logarithmic axes, as SVG.

use std::collections::BTreeMap;

use plotters::prelude::*;

use super::Point;
use super::series::{BASE, TOGETHER, names};

/// Width of the legend over that of the rest.
const LEGEND: f64 = 0.32;

/// Size of a plot [pixels].
const SIZE: (u32, u32) = (880, 560);

/// A named line of points (x, error).
struct Line {
    name: String,
    points: Vec<(f64, f64)>,
}

/// Colours that people with colour-blindness tell apart (Okabe & Ito 2008), and some more: one for each line.
const COLOURS: [RGBColor; 11] = [
    RGBColor(0, 114, 178),
    RGBColor(213, 94, 0),
    RGBColor(0, 158, 115),
    RGBColor(204, 121, 167),
    RGBColor(230, 159, 0),
    RGBColor(86, 180, 233),
    RGBColor(90, 90, 90),
    RGBColor(160, 100, 40),
    RGBColor(0, 0, 0),
    RGBColor(110, 60, 160),
    RGBColor(200, 190, 30),
];

/// Error against processor time of every method, of all rungs together and of the settings as they are, with the Pareto
/// front of all points: those that no other beats in both.
pub fn front(title: &str, points: &[Point], noise: f64) -> Result<String, String> {
    let shown = |p: &&Point| p.score.mean > 0.0 && p.cpu_seconds > 0.0;
    let mut by: BTreeMap<&str, Vec<(f64, f64)>> = BTreeMap::new();
    for p in points.iter().filter(shown).filter(|p| !is_sweep(p)) {
        let name = match p.series.as_str() {
            BASE => "settings as they are",
            TOGETHER => "all settings together",
            _ => &p.method,
        };
        by.entry(name).or_default().push((p.cpu_seconds, visible(p, noise)));
    }
    let lines: Vec<Line> =
        by.into_iter().map(|(name, points)| Line { name: name.into(), points: sorted(points) }).collect();
    let all: Vec<(f64, f64)> = points.iter().filter(shown).map(|p| (p.cpu_seconds, visible(p, noise))).collect();
    draw(title, "processor time of the light [s]", &lines, &pareto(all), noise)
}

/// Error against the value of each swept setting, over that of its finest.
pub fn sweeps(title: &str, points: &[Point], noise: f64) -> Result<String, String> {
    let mut by: BTreeMap<&str, Vec<(f64, f64)>> = BTreeMap::new();
    for p in points.iter().filter(|p| is_sweep(p) && p.x > 0.0) {
        by.entry(&p.series).or_default().push((p.x, visible(p, noise)));
    }
    let relative = |points: Vec<(f64, f64)>| {
        let finest = points.iter().map(|p| p.0).fold(0.0, f64::max);
        sorted(points.into_iter().map(|(x, e)| (x / finest, e)).collect())
    };
    let lines: Vec<Line> =
        by.into_iter().map(|(name, points)| Line { name: name.into(), points: relative(points) }).collect();
    draw(title, "work in one setting, over the most that was tried", &lines, &[], noise)
}

/// The point differs from the settings as they are in one of them.
fn is_sweep(p: &Point) -> bool {
    names().any(|name| name == p.series)
}

/// An error that has a logarithm: one that is not told from none is drawn far below the noise of the reference.
fn visible(p: &Point, noise: f64) -> f64 {
    p.score.rmse.max(0.1 * noise).max(1e-6)
}

fn sorted(mut points: Vec<(f64, f64)>) -> Vec<(f64, f64)> {
    points.sort_by(|a, b| a.0.total_cmp(&b.0));
    points
}

/// The points that no other is better than, by rising cost.
pub fn pareto(points: Vec<(f64, f64)>) -> Vec<(f64, f64)> {
    let mut front: Vec<(f64, f64)> = Vec::new();
    for (x, e) in sorted(points) {
        if front.last().is_none_or(|last| e < last.1) {
            front.push((x, e));
        }
    }
    front
}

/// A range that holds all values with a little room, and is never empty.
fn range(values: impl Iterator<Item = f64> + Clone) -> (f64, f64) {
    let lo = values.clone().fold(f64::INFINITY, f64::min);
    let hi = values.fold(0.0, f64::max);
    if lo.is_finite() && hi > 0.0 { (lo / 1.4, hi * 1.4) } else { (0.1, 1.0) }
}

/// 1, 2 and 5 times the powers of ten in a range; of a wide one the powers alone.
fn ticks((lo, hi): (f64, f64)) -> Vec<f64> {
    let steps: &[f64] = if hi / lo > 3e4 { &[1.0] } else { &[1.0, 2.0, 5.0] };
    let powers = lo.log10().floor() as i32..=hi.log10().floor() as i32;
    let all = powers.flat_map(|power| steps.iter().map(move |step| step * 10f64.powi(power)));
    all.filter(|tick| (lo..=hi).contains(tick)).collect()
}

fn draw(title: &str, axis: &str, lines: &[Line], front: &[(f64, f64)], noise: f64) -> Result<String, String> {
    let mut svg = String::new();
    {
        let area = SVGBackend::with_string(&mut svg, SIZE).into_drawing_area();
        paint(&area, title, axis, lines, front, noise).map_err(|e| e.to_string())?;
        area.present().map_err(|e| e.to_string())?;
    }
    Ok(svg)
}

type Area<'s> = DrawingArea<SVGBackend<'s>, plotters::coord::Shift>;
type Failure<'s> = DrawingAreaErrorKind<<SVGBackend<'s> as DrawingBackend>::ErrorType>;

fn paint<'s>(
    area: &Area<'s>,
    title: &str,
    axis: &str,
    lines: &[Line],
    front: &[(f64, f64)],
    noise: f64,
) -> Result<(), Failure<'s>> {
    area.fill(&WHITE)?;
    let points = || lines.iter().flat_map(|l| &l.points).chain(front);
    let (x, y) =
        (range(points().map(|p| p.0)), range(points().map(|p| p.1).chain([noise].into_iter().filter(|n| *n > 0.0))));
    // The legend has the right of the plot to itself.
    let x = (x.0, x.1 * (x.1 / x.0).powf(LEGEND));
    let mut chart = ChartBuilder::on(area)
        .caption(title, ("sans-serif", 20))
        .margin(14)
        .x_label_area_size(46)
        .y_label_area_size(64)
        .build_cartesian_2d(
            (x.0..x.1).log_scale().with_key_points(ticks(x)),
            (y.0..y.1).log_scale().with_key_points(ticks(y)),
        )?;
    chart
        .configure_mesh()
        .x_desc(axis)
        .y_desc("RMSE over the mean irradiance")
        .x_label_formatter(&|x| short(*x))
        .y_label_formatter(&|y| format!("{} %", short(100.0 * y)))
        .label_style(("sans-serif", 13))
        .axis_desc_style(("sans-serif", 15))
        .bold_line_style(RGBColor(215, 215, 215))
        .draw()?;
    if !front.is_empty() {
        let style = RGBColor(205, 205, 205).stroke_width(9);
        chart
            .draw_series(LineSeries::new(front.iter().copied(), style))?
            .label("Pareto front")
            .legend(move |(x, y)| PathElement::new([(x, y), (x + 18, y)], style));
    }
    for (line, colour) in lines.iter().zip(COLOURS.into_iter().cycle()) {
        chart
            .draw_series(LineSeries::new(line.points.iter().copied(), colour.stroke_width(2)))?
            .label(&line.name)
            .legend(move |(x, y)| PathElement::new([(x, y), (x + 18, y)], colour.stroke_width(2)));
        chart.draw_series(line.points.iter().map(|p| Circle::new(*p, 3, colour.filled())))?;
    }
    if noise > 0.0 {
        let style = BLACK.stroke_width(1);
        chart
            .draw_series(DashedLineSeries::new([(x.0, noise), (x.1, noise)], 5, 4, style))?
            .label("noise of the reference")
            .legend(move |(x, y)| {
                let dash = |from: i32| PathElement::new([(from, 0), (from + 5, 0)], style);
                EmptyElement::at((x, y)) + dash(0) + dash(7) + dash(14)
            });
    }
    chart
        .configure_series_labels()
        .position(SeriesLabelPosition::UpperRight)
        .background_style(WHITE.mix(0.85))
        .border_style(RGBColor(200, 200, 200))
        .label_font(("sans-serif", 13))
        .draw()
}

/// Three significant digits without trailing zeros.
fn short(x: f64) -> String {
    let decimals = (2.0 - x.abs().max(1e-12).log10().floor()).clamp(0.0, 9.0) as usize;
    let text = format!("{x:.decimals$}");
    if text.contains('.') { text.trim_end_matches('0').trim_end_matches('.').into() } else { text }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::study::Score;

    #[test]
    fn the_front_is_what_nothing_beats() {
        let points = vec![(1.0, 0.5), (2.0, 0.6), (3.0, 0.2), (4.0, 0.2), (0.5, 0.9)];
        assert_eq!(pareto(points), [(0.5, 0.9), (1.0, 0.5), (3.0, 0.2)]);
        assert!(pareto(Vec::new()).is_empty());
    }

    #[test]
    fn a_plot_names_its_lines_and_none_is_a_plot_too() {
        let point = |x: f64, e: f64| Point {
            method: "path tracing".into(),
            series: "path tracing".into(),
            x,
            cpu_seconds: x,
            score: Score { rmse: e, mean: 1.0, ..Score::default() },
            ..Point::default()
        };
        let svg = front("Cornell", &[point(1.0, 0.1), point(4.0, 0.05)], 0.01).unwrap();
        assert!(svg.starts_with("<svg") && svg.contains("path tracing") && svg.contains("Pareto front"));
        assert!(front("nothing", &[], 0.0).unwrap().starts_with("<svg"));
        assert!(sweeps("nothing", &[], 0.0).unwrap().starts_with("<svg"));
    }

    #[test]
    fn ticks_are_where_the_range_is() {
        assert_eq!(ticks((0.016, 0.21)).iter().map(|t| short(*t)).collect::<Vec<_>>(), ["0.02", "0.05", "0.1", "0.2"]);
        assert_eq!(ticks((0.5, 90_000.0)).len(), 5);
    }

    #[test]
    fn numbers_are_short() {
        assert_eq!([0.012_34, 1.0, 250.0, 12_345.0, 0.5].map(short), ["0.0123", "1", "250", "12345", "0.5"]);
    }
}
