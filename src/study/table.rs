//! The paper's Table 1 (Piwowar & Malgouyres 2009, §5), row by row, beside what luxel measures.

use std::collections::BTreeMap;

use luxel_export::report::Table1;
use serde::Serialize;

use super::series;
use crate::settings::Settings;

/// A column of the table.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Column {
    pub name: String,
    pub figures: Table1,
}

/// The two columns of the paper, with its names (what it calls direct photons are those from one primary photon): a scene of 1,176 triangles without, and one of 67,462 with anti-aliasing.
pub fn printed() -> [Column; 2] {
    let rates = |table: Table1, continuous: f64, discrete: f64| Table1 {
        continuous_rays_per_second: continuous,
        discrete_rays_per_second: discrete,
        discrete_over_continuous: discrete / continuous,
        ..table
    };
    let first = Table1 {
        triangles: 1176,
        voxels: 108_455,
        light_path_length: 4,
        voxel_directions: 146,
        primary_photons: 650,
        direct_photons: 200,
        continuous_rays: 87_913_202,
        discrete_rays: 26_637_785,
        propagation_seconds: 6.1,
        linear_method_seconds: 5.2,
        reconstruction_seconds: 624.3,
        overall_seconds: 630.5,
        ..Table1::default()
    };
    let second = Table1 {
        triangles: 67_462,
        voxels: 22_615,
        light_path_length: 6,
        voxel_directions: 256,
        primary_photons: 4000,
        direct_photons: 256,
        continuous_rays: 184_834_570,
        discrete_rays: 10_146_637,
        propagation_seconds: 4.15,
        linear_method_seconds: 1.96,
        reconstruction_seconds: 2679.27,
        overall_seconds: 2684.43,
        ..Table1::default()
    };
    let column = |name: &str, figures| Column { name: name.into(), figures };
    [
        column("paper, scene 1", rates(first, 140_819.0, 5_122_651.0)),
        column("paper, scene 2", rates(second, 68_983.0, 5_176_855.0)),
    ]
}

/// The columns that are measured here, by their names: the paper's settings, and the settings as they are.
pub fn settings(base: &Settings, triangles: usize) -> [(&'static str, Settings); 2] {
    let of_the_paper = settings_of_the_paper(base, triangles);
    [("the paper's settings here", of_the_paper), ("the settings as they are", base.clone())]
}

/// The settings with which the column of the paper that is nearest in triangles was made.
fn settings_of_the_paper(base: &Settings, triangles: usize) -> Settings {
    let [first, second] = printed().map(|column| column.figures);
    let printed = if triangles < 10_000 { first } else { second };
    series::of_the_paper(
        base,
        printed.voxels as u32,
        printed.voxel_directions as u32,
        (printed.primary_photons * printed.direct_photons) as u32,
        printed.light_path_length as u32,
    )
}

/// The rows as the paper names them, each with its value in every column.
pub fn rows(columns: &[Column]) -> Vec<(&'static str, Vec<String>)> {
    type Show = fn(&Table1) -> String;
    let rows: [(&str, Show); 14] = [
        ("number of triangles", |t| t.triangles.to_string()),
        ("number of voxels", |t| t.voxels.to_string()),
        ("light path length", |t| t.light_path_length.to_string()),
        ("voxel directions", |t| t.voxel_directions.to_string()),
        ("primary photons", |t| t.primary_photons.to_string()),
        ("direct photons", |t| t.direct_photons.to_string()),
        ("continuous rays", |t| t.continuous_rays.to_string()),
        ("discrete rays", |t| t.discrete_rays.to_string()),
        ("rays/s (continuous)", |t| format!("{:.0}", t.continuous_rays_per_second)),
        ("rays/s (discrete)", |t| format!("{:.0}", t.discrete_rays_per_second)),
        ("continuous/discrete", |t| match t.discrete_over_continuous {
            ratio if ratio > 0.0 => format!("{:.2} %", 100.0 / ratio),
            _ => "-".into(),
        }),
        ("propagation time [s]", |t| format!("{:.2}", t.propagation_seconds)),
        ("linear method time [s]", |t| format!("{:.2}", t.linear_method_seconds)),
        ("reconstruction time [s]", |t| format!("{:.2}", t.reconstruction_seconds)),
    ];
    let last: Show = |t| format!("{:.2}", t.overall_seconds);
    let all = rows.into_iter().chain([("overall time [s]", last)]);
    all.map(|(name, show)| (name, columns.iter().map(|c| show(&c.figures)).collect())).collect()
}

/// The table as text, aligned for a terminal; Markdown shows it too.
pub fn text(columns: &[Column]) -> String {
    let mut lines =
        vec![std::iter::once(String::new()).chain(columns.iter().map(|c| c.name.clone())).collect::<Vec<_>>()];
    lines.extend(rows(columns).into_iter().map(|(name, cells)| [vec![name.to_owned()], cells].concat()));
    grid(&lines)
}

/// Lines of cells as a Markdown table: the first line is its head, its first column is left-aligned.
pub fn grid(lines: &[Vec<String>]) -> String {
    let width: BTreeMap<usize, usize> =
        lines.iter().flat_map(|line| line.iter().enumerate()).fold(BTreeMap::new(), |mut widths, (i, cell)| {
            let widest = widths.entry(i).or_insert(3);
            *widest = (*widest).max(cell.chars().count());
            widths
        });
    let pad = |i: usize, cell: &str| {
        let gap = " ".repeat(width.get(&i).copied().unwrap_or(3).saturating_sub(cell.chars().count()));
        if i == 0 { format!("{cell}{gap}") } else { format!("{gap}{cell}") }
    };
    let line = |cells: &Vec<String>| {
        let cells: Vec<String> = cells.iter().enumerate().map(|(i, cell)| pad(i, cell)).collect();
        format!("| {} |\n", cells.join(" | "))
    };
    let rule: Vec<String> = width
        .values()
        .enumerate()
        .map(|(i, w)| if i == 0 { "-".repeat(*w) } else { format!("{}:", "-".repeat(w - 1)) })
        .collect();
    let mut text = String::new();
    for (i, cells) in lines.iter().enumerate() {
        text += &line(cells);
        if i == 0 {
            text += &format!("| {} |\n", rule.join(" | "));
        }
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_papers_own_ratios_come_out() {
        let table = rows(&printed());
        let (_, ratios) = table.iter().find(|(name, _)| *name == "continuous/discrete").unwrap();
        assert_eq!(ratios, &["2.75 %", "1.33 %"]);
        assert_eq!(table.len(), 15);
    }

    #[test]
    fn a_grid_is_aligned() {
        let text = grid(&[vec!["".into(), "a".into()], vec!["mm²".into(), "12345".into()]]);
        assert_eq!(text, "|     |     a |\n| --- | ----: |\n| mm² | 12345 |\n");
    }
}
