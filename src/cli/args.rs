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

const ABOUT: &str = "Bakes light into glTF levels: lightmaps, no GPU, no editor.";

const EXAMPLES: &str = "\
Examples:
  luxel bake level.glb                          lightmap, lit .glb, picture and report in baked/
  luxel bake level.glb --preset draft           a first look
  luxel bake level.glb --sky 300,400,600        with a blue sky of 300..600 cd/m²
  luxel bake level.glb --sky noon.hdr           with an image as the sky
  luxel bake levels/ --out lit/                 every scene below a folder, several at a time
  luxel bake levels/ --check                    bakes nothing; exit code 3 when a lightmap is not current
  luxel bake level.glb --verify 500             with its error against the reference at 500 texels
  luxel bake levels/ --max-error 2%             a gate: exit code 1 where a lightmap is not certainly that good
  luxel plan level.glb                          what would run, and why
  luxel watch levels/                           bakes, and again whatever is saved
  luxel watch level.glb --preview               the same, shown in the browser

A scene is left alone when its report says that it was baked from the same bytes, with the same settings, by the same
luxel, and when all its outputs are as they were written; --force bakes it all the same. With --verify its report also
has to tell of a verification of so many texels: then --max-error is judged by that, with --check too.

A verified lightmap is compared as it is written, at texels drawn by their area. Checks: no texel belongs to two charts;
no more than a quarter of the texels lies inside geometry; no texel that a closed wall separates from all light is lit;
the energy ledger balances within 1 % after every stage; no value is negative or no number.

Events of --json, one object per line, with their fields:
  unchanged    scene, outputs                     left alone: its outputs are current; with --verify as baked
  stale        scene, reasons                     they are not; each reason has a code and a message
  started      scene, stage, total                a stage begins
  progress     scene, stage, done, total
  finished     scene, stage, seconds
  plan         scene, plan, unchanged, stale      of luxel plan; stale holds the reasons
  baked        scene, seconds, outputs, quality, warnings   with --verify also verification, checks, as in the report
  failed       scene, error, causes               its last good outputs stay; with --max-error as baked
  done         scenes, failed, unchanged, stale   the last event: a number, and lists of scenes
  interrupted  scene, scenes, failed              the last event after Ctrl-C; scenes were being baked, scene is the first
  usage        error, causes                      the last event of a command line that could not be followed

Exit codes: 0 done, 1 some scenes failed, 2 wrong usage, 3 --check found something stale (and nothing failed), 130
interrupted.";

const WATCHING: &str = "\
Bakes every scene whose outputs are not current, and again whenever a file changes that its last bake read: the .gltf or
.glb, buffers, images, the sky, luxel.toml. A bake that is overtaken by a change stops and starts anew; a file that is
saved without a change bakes nothing; a scene that cannot be baked says why and keeps what was baked last. New scenes in
watched folders are baked too.

Where light has to be gathered anew, a draft comes first: the same files with the same UVs, lit coarsely, without a
picture. The bake replaces it; until one ends well, the draft is what lies there. --check calls it stale, and its report says what it is.

Examples:
  luxel watch level.glb --preset draft          lightmap anew after every save
  luxel watch levels/ --out lit/                every scene below a folder
  luxel watch //server/levels --poll 5          looks every 5 seconds: for drives that tell of no changes
  luxel watch level.glb --preview               serves a page that shows the level and every new lightmap
  luxel watch level.glb --json                  for programs: one event per line

Network drives and folders that the system cannot watch are looked at every 2 seconds without being asked for.

The page of --preview is for browsers on this machine: it comes from 127.0.0.1 and shows outputs of bakes, nothing else.
It shows the level lit, its lightmap alone, albedo, texel density, charts and invalid texels (keys 1 to 6). It is part
of a luxel that was built after it was (npm ci && npm run build in assets/preview); without it, luxel says so and bakes.

Events of --json, one object per line, with their fields:
  preview    url, notice             with --preview: its address, and what is missing, or null
  watching   paths, scenes           once, at the start
  waiting    scene, outputs          after that, each scene; the report of its last bake, if there is one
  polling    folder, reason, seconds nobody tells of changes there, so it is looked at
  unwatched  path, reason            it cannot be watched or searched
  found      scene                   a new scene
  changed    scene, files            other content than before; no files where only settings changed
  moved      scene, glb              other names for its outputs, for there is another scene of its name, or no more
  lost       scene, files            outputs that were current have gone, so it is baked again
  unchanged  scene, files            touched, with the content of before
  removed    scene                   its outputs stay
  baking     scene                   then stages as of luxel bake --json: started, progress, finished
  drafted    scene, seconds, outputs, quality, warnings    a draft lies there until the bake ends
  overtaken  scene                   stopped, because its files changed; another bake follows unless they changed back
  baked      scene, seconds, outputs, quality, warnings
  failed     scene, error, causes, draft   its outputs stay: a draft (true), a bake's (false), or there are none (null)
  current    scene, outputs          as when it was baked: at the start, or again after it was broken
  unshown    scene, error, causes    the preview cannot show its outputs
  idle       scenes, failed, draft   everything is as current as it can be; draft: whose outputs are drafts
  stopped    scenes, failed, draft   the last event
  usage      error, causes           the last event of a command line that could not be followed

Ctrl-C ends it, after the running bake has stopped; a second one, half a second later, ends it at once.
Exit codes: 0 ended, 1 ended with scenes that could not be baked, 2 wrong usage, 130 ended by a second Ctrl-C.";

const MIXING: &str = "\
Lights of one name (of their node, or its extra luxel_group) are one group; the sky is the group sky. luxel plan lists
them. Their light is taken from the store of a bake with the same settings: give the options that the bake had, --out
and --store among them. Where it is not there, the scene fails and says so.

Examples:
  luxel export level.glb --mix sun=0.2,lamps=1.5      dusk, in mixed/
  luxel export level.glb --mix lamps=0 --to day/      the lamps off
  luxel export levels/ --mix sun=0 --to night/        every scene below a folder that has a group sun

Events of --json are those of luxel bake.

Exit codes: 0 done, 1 some scenes failed, 2 wrong usage, 130 interrupted.";

const RENDERING: &str = "\
The picture of a scene from a camera: NAME.render.png as it is displayed and NAME.render.exr as radiance (cd/m², linear
Rec. 709, 32 bit, A = 1), beside the scene's outputs in baked/ or --out DIR. Nothing of a bake is written, but for the
store, in which a picture uses and leaves what bakes with the same settings do. Surfaces are Lambertian: L = Le + ρE/π.

Methods:
  lightcuts    the voxel solution, gathered by lightcuts at every point, direct light and sky exactly
  lightmap     the lightmap of a bake, which is made where the store does not have it
  lookup       the voxel solution, interpolated
  final        the voxel solution, by a final gather
  samples      the voxel solution, by random sample voxels: the picture gets better pass by pass
  voxels       the voxels of the solution, shown directly
  photons      photon mapping, gathered by lightcuts
  paths        path tracing: the reference, without bias, with noise

Every pixel has 4 samples, and all --aa N where what is displayed differs between its samples or from its neighbours, or
where they show other surfaces. The method samples, and with --progressive or --time the method paths, write a first picture
soon and again whenever they have drawn twice as much, until that is spent or the time is over; how far they come in a
given time depends on the machine, what they show then does not.

Examples:
  luxel render level.glb                                        from its camera, by lightcuts
  luxel render level.glb --camera Door --width 1920             another camera, by its name or number
  luxel render level.glb --eye 1,1.7,4 --target 0,1,0 --fov 60  from anywhere
  luxel render level.glb --method lightmap --to lit.png         what an engine shows with the lightmap
  luxel render level.glb --method paths --paths 1000 --time 60  the reference, as far as a minute takes it
  luxel render level.glb --compare photons,lightcuts,paths      side by side, with differences to the last
  luxel render levels/ --out pictures/ --exposure 7             every scene below a folder, at one exposure

--compare writes NAME.compare.png: every method's picture at one exposure, and below each its difference to the last one,
or to --against, in false colour (red is brighter), with RMSE and bias in % of the mean radiance that surfaces reflect,
wall-clock time of all that the method needs, and rays where it counts them. For that, nothing is taken from the store.

Events of --json, one object per line, with their fields:
  started, progress, finished                          stages, as of luxel bake
  pass         scene, method, pass, draws, seconds, error, outputs    of samples; of paths with --progressive or --time
  rendered     scene, method, draws, seconds, width, height, samples, points, rays, error, exposure, outputs, warnings
  compared     scene, against, width, height, exposure, reflected, methods, outputs, warnings   of --compare; each of the
                                                       methods has method, draws, seconds, samples, points, rays,
                                                       error, rmse, bias, p95
  failed       scene, error, causes                    no picture of it was written
  done         scenes, failed, unchanged, stale        the last event
  interrupted  scene, scenes, failed                   the last event after Ctrl-C
  usage        error, causes                           the last event of a command line that could not be followed
draws are those of a method that draws at random, or null; error is its estimated standard error, and as rmse, bias and
p95 a share of the mean reflected radiance, or null; exposure in EV at ISO 100; reflected in cd/m².

Exit codes: 0 done, 1 some scenes failed, 2 wrong usage, 130 interrupted.";

const CACHING: &str = "\
A bake keeps the result of every stage under the digest of all that it follows from, so that the next one makes only
what has changed. Everything in a store can be made again: removing it costs time and nothing else. A bake keeps its
store below a cap by itself, sparing what was used within an hour as long as it is below twice that. The cap belongs to
the store: --store-cap of a bake and --cap of gc set it, in the store's file cap, and it holds for everybody who gives
none.

Examples:
  luxel cache stat                              the stores below this folder
  luxel cache stat levels/ --json               for programs
  luxel cache verify level.glb                  the store beside its outputs in baked/
  luxel cache gc levels/ --cap 2GiB --older 30d
  luxel cache gc --store /srv/luxel --cap 50GiB a store that machines share
  luxel cache gc --cap 0                        empties the stores below this folder

gc removes, first, what is damaged or of an earlier luxel's format, what nobody has used for --older, and temporary
files of killed bakes when they are older than an hour; then the least recently used results beyond --cap. It may run
while others bake: what they miss they make again. Other files in a store's folder are never touched.

Events of --json, one object per line, with their fields; sizes in bytes, times in seconds since 1970:
  stat       store, cap, kept, total, kinds, leftovers, old   cap: bytes, kept: whether it was ever given; of the
                                                   others each has files, bytes, oldest, newest (times of last use)
  outdated   store, file, reason                   of verify: in another luxel's format
  bad        store, file, reason                   of verify: damaged
  verified   store, sound, outdated, bad           numbers of files
  collected  store, evicted, bad, outdated, leftovers, left, failed   each with files, bytes; failed holds file, reason
  failed     store, error, causes                  it cannot be looked through
  done       stores, failed, bad                   the last event: numbers
  usage      error, causes                         the last event of a command line that could not be followed

Exit codes: 0 done, 1 verify found something damaged, or a store could not be read or cleaned, 2 wrong usage.";

const REPORTING: &str = "\
Every point of a report is one way to find the scene's light: a bake with one setting changed, all of them refined
together, or another method. Its light is compared with the reference path tracer at some hundred texels, drawn evenly by
area. Written beside the scene, in report/, or to --out:

  NAME.report.csv   every point: seconds, rays, RMSE, relMSE, bias, percentiles, direct and indirect apart
  NAME.report.md    the same for people, with the laws by which errors fall, what limits the error, and Table 1
  NAME.report.json  laws, advice, Table 1, for programs
  NAME.front.svg    error against processor time of every method, with the Pareto front
  NAME.sweeps.svg   error against each setting
  NAME.maps.png     the atlas: baked, reference, difference

What was measured is kept in a store beside them, the reference too: an interrupted report goes on where it stopped, and
one with more sweeps measures only what is new. Atlases have 128 texels a side unless --size says otherwise.

Examples:
  luxel report level.glb                          everything, with the settings as they are
  luxel report level.glb --sweep voxels,cut_error two settings alone
  luxel report level.glb --sweep none             the methods of the paper's Figure 3, and all settings together
  luxel report level.glb --target-error 2%        the settings for an error; luxel bake --target-error 2% uses them
  luxel report level.glb --target-time 30s        the settings for a time on this machine

Events of --json, one object per line, with their fields, besides those of stages (luxel bake --help):
  point    scene, point                           one measurement
  report   scene, findings                        laws, advice, Table 1, files
  target   scene, rung, flags, rmse, rmse_most, seconds, reached

Exit codes: 0 done, 1 some scenes failed or their target is out of reach, 2 wrong usage, 130 interrupted.";

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
    /// Paths of every point of --method paths [default: 64; with --time, as many as it takes]
    #[arg(long, value_name = "N", help_heading = PICTURE)]
    pub paths: Option<NonZeroU32>,
    /// Passes of --method samples, of two sets of 64 voxels for every point [default: 8; with --time, as many as it takes]
    #[arg(long, value_name = "N", help_heading = PICTURE)]
    pub samples: Option<NonZeroU32>,
    /// Photons of --method photons [default: 50000]
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
    ["texels", "noise", "paths", "sweep", "no_methods", "no_together", "no_table", "no_maps", "fresh"];

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
    /// Leave out the other methods: path tracing, photon map, sample voxels, voxels alone
    #[arg(long)]
    pub no_methods: bool,
    /// Leave out the row in which all settings grow together
    #[arg(long)]
    pub no_together: bool,
    /// Leave out the paper's Table 1
    #[arg(long)]
    pub no_table: bool,
    /// Leave out the error maps
    #[arg(long)]
    pub no_maps: bool,
    /// Measure anew what an earlier report measured
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
