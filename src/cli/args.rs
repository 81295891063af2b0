//! What can be written on the command line. The settings' flags and their help come from [`FIELDS`].

use std::num::{NonZeroU32, NonZeroUsize};
use std::path::PathBuf;
use std::time::Duration;

use clap::{Arg, ArgMatches, Args, Command, FromArgMatches, Parser, Subcommand, error::ErrorKind};
use glam::DVec3;
use luxel::bake::mix::Mix;
use luxel::render::exposure::RANGE;
use luxel::render::lens::MOST_SIDE;
use luxel::render::method::{Entry, named};
use luxel::settings::{FIELDS, Layer, Origin, Settings};
use luxel::store::StoreOptions;
use luxel::verify::Verify;

use super::amount;
use super::help::{ABOUT, CACHING, EXAMPLES, MIXING, RENDERING, REPORTING, WATCHING};

/// Shortest and longest time between looks [s].
const POLL: std::ops::RangeInclusive<f64> = 0.05..=86_400.0;

#[derive(Debug, Parser)]
#[command(name = "luxel", version, about = ABOUT, after_help = EXAMPLES, arg_required_else_help = true)]
pub struct Cli {
    #[command(subcommand)]
    pub task: Task,
}

#[derive(Debug, Subcommand)]
pub enum Task {
    /// Bake scenes: irradiance as .exr, the scene with its lightmap as .glb, a picture, and a report.
    #[command(after_help = EXAMPLES)]
    Bake(Baking),
    /// Bake scenes, and again whenever a file changes that they are made from.
    #[command(after_help = WATCHING)]
    Watch(Watch),
    /// Say which stages a bake would run, reuse or leave out, why, and how much memory it would take.
    Plan(Bake),
    /// Write a baked scene's outputs with other weights of its light groups; nothing is baked for it.
    #[command(after_help = MIXING)]
    Export(Export),
    /// Take pictures of scenes: by lightcuts, from their lightmaps, by the reference; or compare methods.
    #[command(after_help = RENDERING)]
    Render(Render),
    /// Measure error against run time: tables, plots, what limits the error, and the settings for an error or a time.
    #[command(after_help = REPORTING)]
    Report(Report),
    /// Look after the stores that bakes keep for the next ones: how much they hold, whether it is sound, what may go.
    #[command(after_help = CACHING)]
    Cache(Cache),
    /// Print every setting with its effect, unit and default, in the form of a luxel.toml.
    Defaults,
    /// Unwrap meshes for a bake in another process.
    #[command(hide = true)]
    UnwrapWorker,
}

#[derive(Debug, Args)]
pub struct Bake {
    #[command(flatten)]
    pub common: Common,
    /// Folder for the outputs; subfolders of a scanned folder are mirrored [default: baked/ beside each scene]
    #[arg(long, value_name = "DIR")]
    pub out: Option<PathBuf>,
    #[command(flatten)]
    pub storing: Storing,
}

/// Which store is used.
#[derive(Clone, Debug, Args)]
pub struct Storing {
    /// Folder in which results of stages are kept for the next bake, which scenes, processes and machines may share
    /// [default: .luxel/ beside the outputs]
    #[arg(long, value_name = "DIR")]
    pub store: Option<PathBuf>,
    /// How much the store may hold from now on: least recently used results go when a bake is over (64MiB, 2.5GiB,
    /// 10GB) [default: what it was told last, at first 4GiB]
    #[arg(long, value_name = "SIZE", value_parser = amount::size)]
    pub store_cap: Option<u64>,
}

impl Storing {
    pub fn options(&self) -> StoreOptions {
        StoreOptions { folder: self.store.clone(), cap: self.store_cap }
    }
}

#[derive(Debug, Args)]
pub struct Baking {
    #[command(flatten)]
    pub bake: Bake,
    /// Bake nothing and write nothing; exit with 3 when a scene's outputs are not what a bake would write, and say why
    #[arg(long, conflicts_with = "force")]
    pub check: bool,
    /// Bake scenes too whose outputs are current
    #[arg(long)]
    pub force: bool,
    /// Use the least settings with which the RMSE is below this share of the mean irradiance (2%): they are tried once at
    /// some hundred texels, and kept in the store. Settings that are chosen by name stay as they are. --check tries
    /// nothing: a scene whose settings are not known yet is stale
    #[arg(long, value_name = "SHARE", value_parser = amount::share)]
    pub target_error: Option<f64>,
    /// Compare the lightmap with the reference path tracer at so many random texels: error with its 95 % confidence
    /// interval, and checks, in the report
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(16..=1_000_000))]
    pub verify: Option<u32>,
    /// Fail a scene, and leave its last lightmap in place, unless its RMSE is certainly no more than this share of the
    /// mean irradiance (2%, 0.02) and all checks pass; compares 400 texels where --verify says nothing
    #[arg(long, value_name = "SHARE", value_parser = amount::share)]
    pub max_error: Option<f64>,
    /// Scenes at a time, at most; fewer where memory is short [default: one for every thread]
    #[arg(long, value_name = "N")]
    pub jobs: Option<NonZeroUsize>,
}

impl Baking {
    /// What is wanted of a verification, if one is.
    pub fn ask(&self) -> Option<Verify> {
        let wanted = self.verify.is_some() || self.max_error.is_some();
        wanted.then(|| Verify { texels: self.verify.unwrap_or(luxel::verify::TEXELS), max_error: self.max_error })
    }
}

#[derive(Debug, Args)]
pub struct Export {
    #[command(flatten)]
    pub bake: Bake,
    /// Factors on light groups: sun=0.2,lamps=1.5; groups that are not named stay as they are
    #[arg(long, value_name = "GROUP=FACTOR,..", required = true)]
    pub mix: Vec<Mix>,
    /// Folder for what is written [default: mixed/ beside each scene]; --out is that of the bake
    #[arg(long, value_name = "DIR")]
    pub to: Option<PathBuf>,
}

#[derive(Debug, Args)]
pub struct Render {
    #[command(flatten)]
    pub bake: Bake,
    /// Where the light comes from [default: lightcuts]
    #[arg(long, value_name = "METHOD", value_parser = named, conflicts_with = "compare", help_heading = PICTURE)]
    pub method: Option<&'static Entry>,
    /// Methods side by side, each with its difference to the last
    #[arg(long, value_name = "METHOD,..", value_parser = named, value_delimiter = ',', help_heading = PICTURE)]
    pub compare: Vec<&'static Entry>,
    /// The method of the comparison to which the others are compared [default: the last]
    #[arg(long, value_name = "METHOD", value_parser = named, requires = "compare", help_heading = PICTURE)]
    pub against: Option<&'static Entry>,
    /// The scene's camera of this name, or of this number, from 0 [default: its first, else a view that luxel chooses]
    #[arg(long, value_name = "NAME|N", conflicts_with = "eye", help_heading = PICTURE)]
    pub camera: Option<String>,
    /// Look from here, in scene units; with --target
    #[arg(long, value_name = "X,Y,Z", value_parser = place, requires = "target", allow_hyphen_values = true,
          help_heading = PICTURE)]
    pub eye: Option<DVec3>,
    /// Look at this point
    #[arg(long, value_name = "X,Y,Z", value_parser = place, requires = "eye", allow_hyphen_values = true,
          help_heading = PICTURE)]
    pub target: Option<DVec3>,
    /// Vertical field of view of --eye, in degrees [default: 50]
    #[arg(long, value_name = "DEGREES", requires = "eye", allow_hyphen_values = true, help_heading = PICTURE)]
    pub fov: Option<f64>,
    /// Pixels across; one of both sides keeps the camera's aspect [default: the longer side has 960]
    #[arg(long, value_name = "PIXELS", value_parser = side(), help_heading = PICTURE)]
    pub width: Option<u32>,
    /// Pixels down
    #[arg(long, value_name = "PIXELS", value_parser = side(), help_heading = PICTURE)]
    pub height: Option<u32>,
    /// Samples of a pixel with an edge, up to 256; or off: one in the middle of every pixel
    #[arg(long, value_name = "off|N", value_parser = samples, default_value = "16", help_heading = PICTURE)]
    pub aa: u32,
    /// Exposure value at ISO 100: 15 in sunlight, 5 to 8 in rooms, one more is half as bright [default: as the picture
    /// shows most; of a comparison, as the method shows most that others are compared to]
    #[arg(long, value_name = "EV", value_parser = exposure, allow_hyphen_values = true, help_heading = PICTURE)]
    pub exposure: Option<f64>,
    /// Paths of every point of the method paths, at least 2 [default: 64; with --time, as many as it takes]
    #[arg(long, value_name = "N", help_heading = PICTURE)]
    pub paths: Option<NonZeroU32>,
    /// Passes of the method samples, of two sets of 64 voxels for every point [default: 8; with --time, as many as it takes]
    #[arg(long, value_name = "N", help_heading = PICTURE)]
    pub samples: Option<NonZeroU32>,
    /// Photons of the method photons [default: 50000]
    #[arg(long, value_name = "N", help_heading = PICTURE)]
    pub map_photons: Option<NonZeroU32>,
    /// Write the picture as it gets better, by the method paths; samples does so unasked
    #[arg(long, conflicts_with = "compare", help_heading = PICTURE)]
    pub progressive: bool,
    /// The same, for about so many seconds
    #[arg(long, value_name = "SECONDS", value_parser = seconds, conflicts_with = "compare", help_heading = PICTURE)]
    pub time: Option<Duration>,
    /// Name of the picture, a .png; its .exr goes beside it. For one scene
    #[arg(long, value_name = "FILE", value_parser = png, help_heading = PICTURE)]
    pub to: Option<PathBuf>,
}

/// Heading of the options of pictures.
const PICTURE: &str = "Picture";

/// Most samples of a pixel.
const MOST_SAMPLES: u32 = 256;

fn side() -> clap::builder::RangedI64ValueParser<u32> {
    clap::value_parser!(u32).range(1..=i64::from(MOST_SIDE))
}

fn place(text: &str) -> Result<DVec3, String> {
    let numbers: Option<Vec<f64>> =
        text.split(',').map(|n| n.trim().parse().ok().filter(|n: &f64| n.is_finite())).collect();
    match numbers.as_deref() {
        Some(&[x, y, z]) => Ok(DVec3::new(x, y, z)),
        _ => Err("expected three numbers with commas between them: 1,1.7,-4".into()),
    }
}

fn samples(text: &str) -> Result<u32, String> {
    match text {
        "off" => Ok(1),
        text => text
            .parse()
            .ok()
            .filter(|n| (1..=MOST_SAMPLES).contains(n))
            .ok_or_else(|| format!("expected off, or a number of samples from 1 to {MOST_SAMPLES}")),
    }
}

fn exposure(text: &str) -> Result<f64, String> {
    let (least, most) = (RANGE.start(), RANGE.end());
    text.parse().ok().filter(|ev| RANGE.contains(ev)).ok_or_else(|| format!("expected EV from {least} to {most}"))
}

fn seconds(text: &str) -> Result<Duration, String> {
    let seconds = text.parse().ok().filter(|s: &f64| *s > 0.0 && *s <= 1e9);
    seconds.map(Duration::from_secs_f64).ok_or_else(|| "expected a number of seconds above 0".into())
}

fn png(text: &str) -> Result<PathBuf, String> {
    let path = PathBuf::from(text);
    let is_png = path.extension().is_some_and(|e| e.eq_ignore_ascii_case("png")) && path.file_stem().is_some();
    if is_png { Ok(path) } else { Err("expected the name of a .png".into()) }
}

/// Arguments of a whole report, which say nothing where settings are looked for.
const WHOLE: [&str; 9] =
    ["texels", "noise", "paths", "sweep", "methods", "no_together", "no_table", "no_maps", "fresh"];

#[derive(Debug, Args)]
pub struct Report {
    #[command(flatten)]
    pub bake: Bake,
    /// Print the settings with which the RMSE is below this share of the mean irradiance, and do nothing else
    #[arg(long, value_name = "SHARE", value_parser = amount::share, conflicts_with_all = WHOLE)]
    pub target_error: Option<f64>,
    /// Print the best settings with which light takes at most so long on this machine, and do nothing else
    #[arg(long, value_name = "TIME", value_parser = amount::time, conflicts_with_all = WHOLE, conflicts_with = "target_error")]
    pub target_time: Option<Duration>,
    /// Texels at which errors are measured
    #[arg(long, value_name = "N", default_value_t = 400, value_parser = clap::value_parser!(u32).range(10..=1_000_000))]
    pub texels: u32,
    /// The reference walks until its noise is below this share of the mean irradiance, at most --paths a texel
    #[arg(long, value_name = "SHARE", default_value = "0.3%", value_parser = amount::share)]
    pub noise: f64,
    /// Most paths a texel of the reference
    #[arg(long, value_name = "N", default_value_t = 65_536, value_parser = clap::value_parser!(u32).range(1024..=16_777_216))]
    pub paths: u32,
    /// Settings to sweep, separated by commas, or none [default: all of them]
    #[arg(long, value_name = "SETTING,..", value_delimiter = ',')]
    pub sweep: Option<Vec<String>>,
    /// Methods to compare, separated by commas, or none: paths, photons, samples, voxels, lookup, final, lightcuts
    /// [default: all of them]
    #[arg(long, value_name = "METHOD,..", value_delimiter = ',')]
    pub methods: Option<Vec<String>>,
    /// Leave out the row in which all settings grow together
    #[arg(long)]
    pub no_together: bool,
    /// Leave out the paper's Table 1
    #[arg(long)]
    pub no_table: bool,
    /// Leave out the error maps
    #[arg(long)]
    pub no_maps: bool,
    /// Measure anew what an earlier report measured; the reference and the error map, which tell no times, stay
    #[arg(long)]
    pub fresh: bool,
}

#[derive(Debug, Args)]
pub struct Watch {
    #[command(flatten)]
    pub bake: Bake,
    /// Look for changes every so many seconds instead of being told: for network drives
    #[arg(long, value_name = "SECONDS", value_parser = interval)]
    pub poll: Option<Duration>,
    /// Write no draft before a bake that takes longer
    #[arg(long)]
    pub no_draft: bool,
    /// Show lightmaps in the browser, as they are baked: serves a page on this machine, for this machine
    #[arg(long)]
    pub preview: bool,
    /// Port of the preview's page [default: 0, any that is free]
    #[arg(long, requires = "preview")]
    pub port: Option<u16>,
}

#[derive(Debug, Args)]
pub struct Cache {
    #[command(subcommand)]
    pub task: CacheTask,
}

#[derive(Debug, Subcommand)]
pub enum CacheTask {
    /// How much the stores hold, by stage, and when it was last used.
    Stat(Places),
    /// Read everything and name what is damaged; changes nothing. Exit code 1 when something is.
    Verify(Places),
    /// Remove what is of no use any more: damaged, outdated, long unused, and what killed bakes left.
    Gc(Gc),
}

impl Cache {
    pub fn places(&self) -> &Places {
        match &self.task {
            CacheTask::Stat(places) | CacheTask::Verify(places) | CacheTask::Gc(Gc { places, .. }) => places,
        }
    }
}

/// The stores that are meant.
#[derive(Debug, Args)]
pub struct Places {
    /// Scenes, for the store beside their outputs in baked/, or folders, for all stores below [default: .]
    #[arg(value_name = "PATH")]
    pub paths: Vec<PathBuf>,
    /// A store that was named to bakes by --store
    #[arg(long, value_name = "DIR")]
    pub store: Option<PathBuf>,
    /// One JSON object per line on standard output
    #[arg(long)]
    pub json: bool,
}

#[derive(Debug, Args)]
pub struct Gc {
    #[command(flatten)]
    pub places: Places,
    /// How much each store may hold from now on: least recently used results go (64MiB, 2.5GiB, 10GB); 0 empties it,
    /// this once [default: what it was told last, at first 4GiB]
    #[arg(long, value_name = "SIZE", value_parser = amount::size)]
    pub cap: Option<u64>,
    /// Remove results that nobody has used for this time (90s, 45m, 12h, 30d, 2w)
    #[arg(long, value_name = "TIME", value_parser = amount::time)]
    pub older: Option<Duration>,
}

fn interval(text: &str) -> Result<Duration, String> {
    let seconds = text.parse().ok().filter(|s| POLL.contains(s));
    let expected = || format!("expected a number of seconds from {} to {}", POLL.start(), POLL.end());
    seconds.map(Duration::from_secs_f64).ok_or_else(expected)
}

#[derive(Debug, Args)]
pub struct Common {
    /// .gltf or .glb files, or folders of them
    #[arg(required = true, value_name = "SCENE")]
    pub scenes: Vec<PathBuf>,
    /// Settings file [default: luxel.toml beside each scene, if there is one]
    #[arg(long, value_name = "FILE")]
    pub config: Option<PathBuf>,
    /// One JSON object per line on standard output
    #[arg(long)]
    pub json: bool,
    /// Nothing but errors
    #[arg(long, short)]
    pub quiet: bool,
    #[command(flatten)]
    pub settings: Flags,
}

/// The settings chosen by flags.
#[derive(Clone, Debug)]
pub struct Flags(pub Layer);

impl Args for Flags {
    fn augment_args(mut command: Command) -> Command {
        let defaults = Settings::default();
        for field in FIELDS {
            let help = format!("{} [default: {}]", field.effect(), (field.get)(&defaults));
            let mut arg = Arg::new(field.name).long(field.flag()).help_heading(field.group);
            arg = arg.help(help.clone()).long_help(format!("{help}\nValue: {}", (field.form)()));
            arg = arg.value_name(field.unit.to_uppercase()).allow_hyphen_values(true);
            let check = |text: &str| match field.assign(&mut Settings::default(), text) {
                true => Ok(text.to_owned()),
                false => Err(format!("expected {}", field.expected(text))),
            };
            arg = arg.value_parser(check);
            if field.is_switch {
                // With an equals sign only, so that `--bound level.glb` names a scene.
                arg = arg.num_args(0..=1).require_equals(true).default_missing_value("true");
            }
            command = command.arg(arg);
        }
        command
    }

    fn augment_args_for_update(command: Command) -> Command {
        Self::augment_args(command)
    }
}

impl FromArgMatches for Flags {
    fn from_arg_matches(matches: &ArgMatches) -> Result<Self, clap::Error> {
        let mut layer = Layer::new(Origin::CommandLine);
        for field in FIELDS {
            if let Some(text) = matches.get_one::<String>(field.name) {
                // The flag's parser has accepted the text already.
                let refused = |e| clap::Error::raw(ErrorKind::ValueValidation, e);
                layer.set(field.name, text).map_err(refused)?;
            }
        }
        Ok(Self(layer))
    }

    fn update_from_arg_matches(&mut self, matches: &ArgMatches) -> Result<(), clap::Error> {
        *self = Self::from_arg_matches(matches)?;
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use clap::CommandFactory;
    use luxel::settings::resolve;

    fn bake(line: &str) -> Result<Bake, clap::Error> {
        match Cli::try_parse_from(line.split(' '))?.task {
            Task::Bake(task) => Ok(task.bake),
            other => panic!("{other:?}"),
        }
    }

    #[test]
    fn the_command_line_is_well_formed() {
        Cli::command().debug_assert();
    }

    #[test]
    fn every_setting_is_a_flag() {
        let args = bake("luxel bake a.glb --size 64 --sky 1,2,3 --bound --sky-rotation -30 b").unwrap();
        assert_eq!(args.common.scenes.len(), 2);
        let settings = resolve(&[args.common.settings.0]).unwrap().settings;
        assert_eq!((settings.size.0, settings.bound, settings.sky_rotation.0), (64, true, -30.0));
        let args = bake("luxel bake --bound a.glb").unwrap();
        assert_eq!(args.common.scenes.len(), 1, "a switch takes no scene for its value");
        let settings = resolve(&[bake("luxel bake a --bound=false").unwrap().common.settings.0]).unwrap().settings;
        assert!(!settings.bound);
    }

    #[test]
    fn watch_takes_what_bake_takes_and_an_interval() {
        let watch = |line: &str| match Cli::try_parse_from(line.split(' '))?.task {
            Task::Watch(watch) => Ok::<_, clap::Error>(watch),
            other => panic!("{other:?}"),
        };
        let args = watch("luxel watch a.glb levels --poll 0.5 --size 64 --out lit").unwrap();
        assert_eq!(args.poll, Some(Duration::from_millis(500)));
        assert_eq!((args.bake.common.scenes.len(), args.bake.out), (2, Some("lit".into())));
        assert_eq!(watch("luxel watch a.glb").unwrap().poll, None);
        assert_eq!(watch("luxel watch a.glb --preview --port 8080").unwrap().port, Some(8080));
        assert!(watch("luxel watch a.glb --port 8080").unwrap_err().to_string().contains("--preview"));
        for wrong in ["0", "-1", "nan", "inf", "1e9", "often"] {
            let message = watch(&format!("luxel watch a.glb --poll={wrong}")).unwrap_err().to_string();
            assert!(message.contains("--poll") && message.contains("from 0.05 to 86400"), "{message}");
        }
    }

    #[test]
    fn bakes_share_a_store_that_is_named() {
        let options = |line: &str| bake(line).map(|args| args.storing.options());
        assert_eq!(options("luxel bake a.glb").unwrap(), StoreOptions::default());
        let shared = StoreOptions { folder: Some("/srv/luxel".into()), cap: Some(3 << 29) };
        assert_eq!(options("luxel bake a.glb --store /srv/luxel --store-cap 1.5GiB").unwrap(), shared);
        let message = options("luxel bake a.glb --store-cap much").unwrap_err().to_string();
        assert!(message.contains("--store-cap") && message.contains("500MB"), "{message}");
    }

    #[test]
    fn gc_takes_a_cap_and_an_age() {
        let cache = |line: &str| match Cli::try_parse_from(line.split(' ')).unwrap().task {
            Task::Cache(cache) => cache.task,
            other => panic!("{other:?}"),
        };
        let CacheTask::Gc(gc) = cache("luxel cache gc levels --cap 2GiB --older 30d") else { panic!() };
        assert_eq!((gc.cap, gc.older), (Some(2 << 30), Some(Duration::from_secs(30 * 86_400))));
        let CacheTask::Gc(gc) = cache("luxel cache gc") else { panic!() };
        assert_eq!((gc.cap, gc.older, gc.places.paths.len()), (None, None, 0));
    }

    #[test]
    fn every_event_of_the_help_is_an_event_of_the_library() {
        let schema = include_str!("../watch/event.rs");
        let lines = WATCHING.lines().skip_while(|l| !l.starts_with("Events of --json")).skip(1);
        let names: Vec<&str> = lines.take_while(|l| l.starts_with("  ")).filter_map(|l| l.split(' ').nth(2)).collect();
        assert_eq!(names.len(), schema.lines().filter(|l| l.starts_with("//! | `")).count() - 1);
        for name in names {
            assert!(schema.contains(&format!("//! | `{name}` |")), "{name}");
        }
    }

    #[test]
    fn pictures_take_views_and_methods() {
        let render = |line: &str| match Cli::try_parse_from(line.split(' '))?.task {
            Task::Render(render) => Ok::<_, clap::Error>(render),
            other => panic!("{other:?}"),
        };
        let args = render("luxel render a.glb --eye -1,2,3e0 --target 0,0,-1 --fov 40 --aa off --exposure -2").unwrap();
        assert_eq!((args.eye, args.target), (Some(DVec3::new(-1.0, 2.0, 3.0)), Some(DVec3::NEG_Z)));
        assert_eq!((args.fov, args.aa, args.exposure), (Some(40.0), 1, Some(-2.0)));
        let args = render("luxel render a.glb --compare lightcuts,paths --against lightcuts").unwrap();
        assert_eq!(args.compare.iter().map(|m| m.name).collect::<Vec<_>>(), ["lightcuts", "paths"]);
        assert_eq!(args.against.map(|m| m.name), Some("lightcuts"));
        for (wrong, expected) in [
            ("--method cuts", "there is no method \"cuts\"; there are: lightcuts"),
            ("--compare lightcuts,cuts", "there is no method"),
            ("--eye 1,2 --target 0,0,0", "three numbers"),
            ("--eye 1,2,nan --target 0,0,0", "three numbers"),
            ("--eye 1,2,3", "--target"),
            ("--fov 60", "--eye"),
            ("--camera 0 --eye 1,2,3 --target 0,0,0", "cannot be used with"),
            ("--width 0", "1..=16384"),
            ("--height 16385", "1..=16384"),
            ("--aa 257", "1 to 256"),
            ("--exposure bright", "-60 to 60"),
            ("--time 0", "above 0"),
            ("--paths 0", "--paths"),
            ("--to picture.jpg", "a .png"),
            ("--method paths --compare paths", "cannot be used with"),
            ("--against paths", "--compare"),
        ] {
            let message = render(&format!("luxel render a.glb {wrong}")).unwrap_err().to_string();
            assert!(message.contains(expected), "{wrong}: {message}");
        }
    }

    #[test]
    fn the_help_of_render_lists_every_method_with_its_first_words() {
        for entry in luxel::render::method::METHODS {
            let line = RENDERING.lines().find(|l| l.starts_with(&format!("  {} ", entry.name)));
            assert!(line.is_some(), "{}", entry.name);
        }
    }

    #[test]
    fn wrong_values_name_the_flag_and_what_fits() {
        let message = bake("luxel bake a.glb --size big").unwrap_err().to_string();
        assert!(message.contains("--size") && message.contains("16 to 16384"), "{message}");
        let message = bake("luxel bake a.glb --sky noon.png").unwrap_err().to_string();
        assert!(message.contains("'noon.png'") && message.contains("--sky") && message.contains(".hdr"), "{message}");
        assert!(!message.contains("Usage"), "{message}");
        let message = bake("luxel bake a.glb --preset darft").unwrap_err().to_string();
        assert!(message.contains("did you mean `draft`"), "{message}");
        assert!(bake("luxel bake").is_err());
        assert!(bake("luxel bake a --siez 3").unwrap_err().to_string().contains("--size"));
    }
}
