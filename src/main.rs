//! The tool `luxel`: a thin skin over the library.

mod cli;

use std::process::ExitCode;

fn main() -> ExitCode {
    // A panic within a scene becomes that scene's error, which tells the rest; this is where in the code it was.
    std::panic::set_hook(Box::new(|panic| {
        eprintln!("luxel: internal error: {}", luxel::text::lines(&panic.to_string()))
    }));
    cli::main()
}
