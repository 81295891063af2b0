//! `luxel watch`: the command line's view of a watch, and of its preview.

use std::path::PathBuf;

use luxel::live::{self, Bundle, Live};
use luxel::text::shown as name;
use luxel::watch::event::{Event, Fault};
use luxel::watch::{self, Choices, Finished, Options, Task};

use super::args::Watch;
use super::progress::{Reporter, Style, duration, event, say};
use super::{DONE, SOME_FAILED, config, on_interrupt, print};

/// Bakes until it is interrupted.
pub fn watch(args: &Watch) -> anyhow::Result<u8> {
    let common = &args.bake.common;
    // Read again by every bake; what is wrong with it now is wrong usage.
    config(common)?;
    let options = Options {
        paths: Options::paths(&common.scenes)?,
        out: args.bake.out.clone(),
        choices: Choices { config: common.config.clone(), flags: common.settings.0.clone() },
        worker: std::env::current_exe().ok(),
        store: args.bake.storing.options(),
    };
    let style = Style::choose(common.json, common.quiet);
    let watch = watch::Watch::new(options, args.poll);
    let stopper = watch.stopper();
    on_interrupt(move || stopper.stop())?;
    let live = args.preview.then(|| serve(style, args.port)).transpose()?;
    let ending = watch.run(&|task: &Task| bake(style, !args.no_draft, task), &mut |event| {
        // Pages hear of it first: somebody waits for them.
        let unshown = live.as_ref().and_then(|live| show(live, &event));
        tell(style, event);
        unshown.into_iter().for_each(|event| tell(style, event));
    });
    Ok(if ending.failed.is_empty() { DONE } else { SOME_FAILED })
}

/// Starts the preview, and says where it is.
fn serve(style: Style, port: Option<u16>) -> anyhow::Result<Live> {
    let live = Live::start(live::Options { port: port.unwrap_or(0), bundle: Bundle::Embedded })?;
    tell(style, Event::Preview { url: live.url(), notice: live.notice().map(str::to_owned) });
    Ok(live)
}

/// Shows in the preview what an event tells; what is to be told where it cannot.
fn show(live: &Live, told: &Event) -> Option<Event> {
    let error = live.follow(told).err()?;
    let (Event::Baked { scene, .. } | Event::Drafted { scene, .. } | Event::Current { scene, .. }) = told else {
        return None;
    };
    Some(Event::Unshown { scene: scene.clone(), fault: Fault::new(&error) })
}

fn bake(style: Style, drafts: bool, task: &Task) -> Result<Finished, luxel::Error> {
    let reporter = Reporter::new(style, &print::written(&task.request.scene), task.cancelled.clone());
    let baked = if drafts {
        luxel::bake_drafted(task.request, &reporter, &mut |draft| (task.drafted)(draft.into()))
    } else {
        luxel::bake(task.request, &reporter)
    };
    reporter.finish();
    Ok(baked?.into())
}

fn tell(style: Style, told: Event) {
    match (style, told) {
        (Style::Json, told) => event(&told.to_json()),
        (_, Event::Failed { scene, fault, draft }) => {
            print::failed(style, &scene, &error(fault));
            if style != Style::Quiet {
                let kept = match draft {
                    Some(true) => "a draft of it stays",
                    Some(false) => "its last lightmap stays",
                    None => "it has no lightmap yet",
                };
                say(&format!(
                    "  {kept}; it is tried again when a file of it changes, or is saved if the fault lay elsewhere"
                ));
            }
        }
        // Without these nobody would find the page, or know why nothing happens.
        (Style::Quiet, told @ (Event::Preview { .. } | Event::Unwatched { .. })) => {
            line(&told).iter().for_each(|line| say(line));
        }
        (Style::Quiet, _) => {}
        (_, Event::Baked { scene, done }) => print::baked(style, &scene, done),
        (_, told) => line(&told).iter().for_each(|line| say(line)),
    }
}

/// A fault as the printer of errors takes it.
fn error(fault: Fault) -> anyhow::Error {
    let causes = fault.causes.into_iter().rev().map(anyhow::Error::msg).reduce(|cause, above| {
        let above = above.to_string();
        cause.context(above)
    });
    match causes {
        Some(causes) => causes.context(fault.error),
        None => anyhow::Error::msg(fault.error),
    }
}

/// What a person reads of an event; nothing of one that concerns programs only.
fn line(told: &Event) -> Option<String> {
    Some(match told {
        Event::Preview { url, notice: None } => format!("preview: {url}"),
        Event::Preview { url, notice: Some(notice) } => format!("preview: {url}\nnote: {notice}"),
        Event::Watching { paths, scenes } => format!("watching {}: {}; Ctrl-C ends it", names(paths), count(*scenes)),
        Event::Polling { folder, reason, seconds } => {
            format!("note: {} is looked at every {seconds} s: {reason}", name(folder))
        }
        Event::Unwatched { path, reason } => format!("note: {} cannot be watched: {reason}", name(path)),
        Event::Found { scene } => format!("{} is new", name(scene)),
        Event::Changed { scene, files } if files.is_empty() => format!("{}: other settings", name(scene)),
        Event::Changed { files, .. } => format!("changed: {}", names(files)),
        Event::Moved { scene, glb } => {
            let why = "a scene of its name has come beside it, or has gone";
            format!("{}: its outputs go to {} from now on, because {why}", name(scene), name(glb))
        }
        Event::Lost { scene, files } => format!("{}: outputs have gone: {}", name(scene), names(files)),
        Event::Removed { scene } => format!("{} has gone; what was baked of it stays", name(scene)),
        Event::Baking { scene } => name(scene),
        Event::Drafted { done, .. } => format!("  draft written after {}", duration(done.seconds)),
        Event::Overtaken { scene } => format!("  stopped: {} has changed meanwhile", name(scene)),
        Event::Current { scene, .. } => format!("{} is as it was when its lightmap was baked", name(scene)),
        Event::Unshown { scene, fault } => {
            let causes = fault.causes.iter().map(|cause| format!(": {cause}")).collect::<String>();
            format!("note: the preview does not show {}: {}{causes}", name(scene), fault.error)
        }
        Event::Idle { failed, draft, .. } => format!("waiting for changes{}", left(failed, draft)),
        Event::Stopped { failed, draft, .. } => format!("ended{}", left(failed, draft)),
        Event::Waiting { .. } | Event::Unchanged { .. } | Event::Baked { .. } | Event::Failed { .. } => return None,
    })
}

/// What is not as it should be.
fn left(failed: &[PathBuf], draft: &[PathBuf]) -> String {
    let some = |what: &str, paths: &[PathBuf]| match paths {
        [] => String::new(),
        paths => format!("; {what}: {}", names(paths)),
    };
    some("not baked", failed) + &some("a draft lies there of", draft)
}

fn count(scenes: usize) -> String {
    if scenes == 1 { "1 scene".into() } else { format!("{scenes} scenes") }
}

/// The first few paths of a list.
fn names(paths: &[PathBuf]) -> String {
    const MOST: usize = 3;
    let some: Vec<String> = paths.iter().take(MOST).map(|path| name(path)).collect();
    let more = paths.len().saturating_sub(MOST);
    if more == 0 { some.join(", ") } else { format!("{} and {more} more", some.join(", ")) }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_fault_keeps_its_causes_in_order() {
        let fault = Fault { error: "a".into(), causes: vec!["b".into(), "c".into()] };
        let chain: Vec<String> = error(fault).chain().map(ToString::to_string).collect();
        assert_eq!(chain, ["a", "b", "c"]);
        assert_eq!(error(Fault { error: "a".into(), causes: Vec::new() }).chain().count(), 1);
    }

    #[test]
    fn what_is_left_is_told() {
        let a = [PathBuf::from("a")];
        assert_eq!(left(&[], &[]), "");
        assert_eq!(left(&a, &a), "; not baked: a; a draft lies there of: a");
    }

    #[test]
    fn long_lists_are_cut() {
        let paths: Vec<PathBuf> = ["a", "b", "c", "d", "e"].map(PathBuf::from).into();
        assert_eq!(names(&paths), "a, b, c and 2 more");
        assert_eq!(names(&paths[..2]), "a, b");
    }
}
