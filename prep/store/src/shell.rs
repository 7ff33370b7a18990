//! What the three commands do alike around their parsers: colour, completions, manual pages.
//!
//! Completions and pages are made of the parser itself, so they cannot say anything else than
//! `--help`. Not here: any option that only one command has.

use std::ffi::OsString;
use std::path::{Path, PathBuf};

use clap::{ColorChoice, Command, ValueEnum as _};
use clap_complete::Shell;

use crate::command::{CliError, DONE, print, print_line};
use crate::{claim, files};

/// The option `--color` of every command. [`take_colour`] has removed it before the parser runs, so
/// that it may stand before or behind a subcommand; here it is for `--help` and for wrong values.
#[derive(Clone, Copy, Debug, clap::Args)]
pub struct ColourArg {
    /// Colours in messages; `auto` is on a terminal, unless NO_COLOR is set
    #[arg(
        long,
        global = true,
        value_name = "WHEN",
        default_value = "auto",
        hide_default_value = true
    )]
    color: ColorChoice,
}

/// Takes `--color WHEN` out of a command line, wherever it stands before `--`, and makes it the rule for
/// everything that is printed. What is not one of its values stays for the parser to refuse.
pub fn take_colour(args: Vec<OsString>) -> (Vec<OsString>, ColorChoice) {
    let (left, choice) = without_colour(args);
    match choice {
        ColorChoice::Auto => anstream::ColorChoice::Auto,
        ColorChoice::Always => anstream::ColorChoice::Always,
        ColorChoice::Never => anstream::ColorChoice::Never,
    }
    .write_global();
    (left, choice)
}

fn without_colour(args: Vec<OsString>) -> (Vec<OsString>, ColorChoice) {
    let choice_of =
        |text: Option<&str>| text.and_then(|text| ColorChoice::from_str(text, true).ok());
    let mut choice = ColorChoice::Auto;
    let mut left = Vec::new();
    let mut rest = args.into_iter().peekable();
    while let Some(argument) = rest.next() {
        if argument == "--" {
            left.push(argument);
            break;
        }
        let joined = argument
            .to_str()
            .and_then(|text| text.strip_prefix("--color="));
        let found = match joined {
            Some(value) => choice_of(Some(value)),
            None if argument == "--color" => {
                let found = choice_of(rest.peek().and_then(|next| next.to_str()));
                if found.is_some() {
                    rest.next();
                }
                found
            }
            None => None,
        };
        match found {
            Some(found) => choice = found,
            None => left.push(argument),
        }
    }
    left.extend(rest);
    (left, choice)
}

/// Columns of the reader's terminal: COLUMNS where it is set, else those of stdout where that is a
/// terminal. `None` for files and pipes.
#[must_use]
pub fn columns() -> Option<usize> {
    let told = std::env::var("COLUMNS")
        .ok()
        .and_then(|text| text.parse().ok());
    let seen = || terminal_size::terminal_size_of(std::io::stdout());
    told.or_else(|| seen().map(|(width, _)| usize::from(width.0)))
        .filter(|columns| *columns > 0)
}

/// Arguments of the subcommand `completions`.
#[derive(Debug, clap::Args)]
pub struct CompletionsArgs {
    /// Shell to print completions for
    #[arg(required_unless_present = "man")]
    shell: Option<Shell>,
    /// Write manual pages into this folder instead
    #[arg(long, value_name = "DIR", conflicts_with = "shell")]
    man: Option<PathBuf>,
}

/// Runs the subcommand `completions` of a command.
///
/// # Errors
/// Something cannot be written, or a file that is no manual page is in the way.
pub fn completions(args: &CompletionsArgs, mut command: Command) -> Result<u8, CliError> {
    let name = command.get_name().to_owned();
    if let Some(shell) = args.shell {
        let mut script = Vec::new();
        clap_complete::generate(shell, &mut command, name, &mut script);
        print(String::from_utf8_lossy(&script))?;
    }
    if let Some(folder) = &args.man {
        command.build();
        let mut pages = Vec::new();
        manual(&command, &mut pages)?;
        for (page, text) in &pages {
            let path = folder.join(page);
            // All pages of clap_mangen begin alike.
            claim::check_file(&path, &[], "completions --man", ".ie \\n(.g .ds Aq")?;
            write_page(&path, text)?;
        }
        print_line(format_args!(
            "{} pages in {}",
            pages.len(),
            folder.display()
        ))?;
    }
    Ok(DONE)
}

fn write_page(path: &Path, text: &[u8]) -> Result<(), CliError> {
    Ok(files::write_atomic(path, text)?)
}

/// The page of a command and those of what stands below it.
fn manual(command: &Command, pages: &mut Vec<(String, Vec<u8>)>) -> Result<(), CliError> {
    let name = command
        .get_display_name()
        .unwrap_or_else(|| command.get_name());
    let mut text = Vec::new();
    clap_mangen::Man::new(command.clone())
        .render(&mut text)
        .map_err(CliError::failed)?;
    pages.push((format!("{name}.1"), text));
    let below = command.get_subcommands();
    below
        .filter(|one| !one.is_hide_set() && one.get_name() != "help")
        .try_for_each(|one| manual(one, pages))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn words(line: &str) -> Vec<OsString> {
        line.split(' ').map(OsString::from).collect()
    }

    #[test]
    fn colour_may_stand_anywhere() {
        for (line, left, choice) in [
            (
                "bench --color never report r",
                "bench report r",
                ColorChoice::Never,
            ),
            (
                "bench report r --color=always",
                "bench report r",
                ColorChoice::Always,
            ),
            ("bench report r", "bench report r", ColorChoice::Auto),
            // Wrong values are for the parser, and names of files for nobody.
            (
                "bench --color mauve",
                "bench --color mauve",
                ColorChoice::Auto,
            ),
            (
                "bench -- --color never",
                "bench -- --color never",
                ColorChoice::Auto,
            ),
        ] {
            assert_eq!(without_colour(words(line)), (words(left), choice), "{line}");
        }
    }

    #[test]
    fn pages_and_completions_are_those_of_the_parser() {
        let command = || {
            Command::new("tool")
                .subcommand(Command::new("work").about("Does the work"))
                .subcommand(Command::new("inner").hide(true))
        };
        let folder = tempfile::tempdir().unwrap();
        let args = |shell, man: Option<&Path>| CompletionsArgs {
            shell,
            man: man.map(Path::to_owned),
        };
        completions(&args(None, Some(folder.path())), command()).unwrap();
        let page = std::fs::read_to_string(folder.path().join("tool-work.1")).unwrap();
        assert!(page.contains("Does the work"), "{page}");
        assert!(!folder.path().join("tool-inner.1").exists());
        // Once more is no harm, but a file of somebody else stays.
        completions(&args(None, Some(folder.path())), command()).unwrap();
        std::fs::write(folder.path().join("tool.1"), "mine").unwrap();
        assert!(completions(&args(None, Some(folder.path())), command()).is_err());
        let mine = std::fs::read_to_string(folder.path().join("tool.1")).unwrap();
        assert_eq!(mine, "mine");
    }
}
