//! What can be written on the command line. The settings' flags and their help come from [`FIELDS`].

use std::num::NonZeroUsize;
use std::path::PathBuf;
use std::time::Duration;

use clap::{Arg, ArgMatches, Args, Command, FromArgMatches, Parser, Subcommand, error::ErrorKind};
use luxel::settings::{FIELDS, Layer, Origin, Settings};

const ABOUT: &str = "Bakes light into glTF levels: lightmaps, no GPU, no editor.";

const EXAMPLES: &str = "\
Examples:
  luxel bake level.glb                          lightmap, lit .glb, picture and report in baked/
  luxel bake level.glb --preset draft           a first look
  luxel bake level.glb --sky 300,400,600        with a blue sky of 300..600 cd/m²
  luxel bake level.glb --sky noon.hdr           with an image as the sky
  luxel bake levels/ --out lit/                 every scene below a folder, several at a time
  luxel bake levels/ --check                    bakes nothing; exit code 3 when a lightmap is not current
  luxel plan level.glb                          what would run, and why
  luxel watch levels/                           bakes, and again whatever is saved

A scene is left alone when its report says that it was baked from the same bytes, with the same settings, by the same
luxel, and when all its outputs are as they were written; --force bakes it all the same.

Events of --json, one object per line, with their fields:
  unchanged    scene, outputs                     left alone: its outputs are current
  stale        scene, reasons                     they are not; each reason has a code and a message
  started      scene, stage, total                a stage begins
  progress     scene, stage, done, total
  finished     scene, stage, seconds
  plan         scene, plan, unchanged, stale      of luxel plan; stale holds the reasons
  baked        scene, seconds, outputs, quality, warnings
  failed       scene, error, causes               its last good outputs stay
  done         scenes, failed, unchanged, stale   the last event: a number, and lists of scenes
  interrupted  scene, scenes, failed              the last event after Ctrl-C; scenes were being baked, scene is the first
  usage        error, causes                      the last event of a command line that could not be followed

Exit codes: 0 done, 1 some scenes failed, 2 wrong usage, 3 --check found something stale (and nothing failed), 130
interrupted.";

const WATCHING: &str = "\
Bakes every scene whose outputs are not current, and again whenever a file changes that its last bake read: the .gltf or
.glb, buffers, images, the sky, luxel.toml. A bake that is overtaken by a change stops and starts anew; a file that is
saved without a change bakes nothing; a scene that cannot be baked says why and keeps its last lightmap. New scenes in
watched folders are baked too.

Examples:
  luxel watch level.glb --preset draft          lightmap anew after every save
  luxel watch levels/ --out lit/                every scene below a folder
  luxel watch //server/levels --poll 5          looks every 5 seconds: for drives that tell of no changes
  luxel watch level.glb --json                  for programs: one event per line

Network drives and folders that the system cannot watch are looked at every 2 seconds without being asked for.

Events of --json, one object per line, with their fields:
  watching   paths, scenes           once, at the start
  polling    folder, reason, seconds nobody tells of changes there, so it is looked at
  unwatched  path, reason            it cannot be watched or searched
  found      scene                   a new scene
  changed    scene, files            other content than before; no files where only settings changed
  unchanged  scene, files            touched, with the content of before
  removed    scene                   its outputs stay
  baking     scene                   then stages as of luxel bake --json: started, progress, finished
  overtaken  scene                   stopped, because its files changed; another bake follows unless they changed back
  baked      scene, seconds, outputs, quality, warnings
  failed     scene, error, causes    its last good outputs stay
  current    scene                   as when it was baked: at the start, or again after it was broken
  idle       scenes, failed          everything is as current as it can be
  stopped    scenes, failed          the last event

Ctrl-C ends it, after the running bake has stopped; a second one ends it at once.
Exit codes: 0 ended, 1 ended with scenes that could not be baked, 2 wrong usage, 130 ended by a second Ctrl-C.";

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
    /// Scenes at a time, at most; fewer where memory is short [default: one for every thread]
    #[arg(long, value_name = "N")]
    pub jobs: Option<NonZeroUsize>,
}

#[derive(Debug, Args)]
pub struct Watch {
    #[command(flatten)]
    pub bake: Bake,
    /// Look for changes every so many seconds instead of being told: for network drives
    #[arg(long, value_name = "SECONDS", value_parser = interval)]
    pub poll: Option<Duration>,
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
        for wrong in ["0", "-1", "nan", "inf", "1e9", "often"] {
            let message = watch(&format!("luxel watch a.glb --poll={wrong}")).unwrap_err().to_string();
            assert!(message.contains("--poll") && message.contains("from 0.05 to 86400"), "{message}");
        }
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
