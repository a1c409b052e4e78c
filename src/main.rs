//! The `springtwin` program: arguments in, exit code out.
// What is printed goes through `cli::stdio`, which bears a reader that goes away.
#![warn(clippy::print_stdout, clippy::print_stderr)]

mod cli;

/// Memory that threads leave behind is used again by those that come after them: the program runs for days.
#[global_allocator]
static ALLOCATOR: mimalloc::MiMalloc = mimalloc::MiMalloc;

fn main() -> std::process::ExitCode {
    cli::program::main()
}
