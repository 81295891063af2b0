//! The tool `luxel`: a thin skin over the library.

mod cli;

use std::process::ExitCode;

fn main() -> ExitCode {
    std::panic::set_hook(Box::new(|panic| {
        eprintln!("luxel: internal error: {panic}");
        eprintln!("This is a bug in luxel, not in your scene. Files that were there before are untouched.");
        // Worker threads must not leave the others waiting for them.
        std::process::exit(101);
    }));
    cli::main()
}
