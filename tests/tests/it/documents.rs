//! What the guides and `--help` tell users to type and to write is what the programs accept.
//!
//! Commands stand in fences marked `sh` and must pass the program's own parser; in `sh run` they are run on a
//! rendered world; `sh not run: why` is for what is no command of ours. Descriptions stand in fences marked
//! `yaml model`, `yaml predictions`, `yaml protocol` or `yaml sprites` and are loaded as `bench` loads them. A quoted line
//! (`> ...`) in FOOTGUNS.md is a message of the code, with `...` for what varies.

use std::ffi::OsString;
use std::path::{Path, PathBuf};

use strat_bench::cues::sprites::SpriteFile;
use strat_bench::evaluate::predictions::SavedDescription;
use strat_bench::model::Description;
use strat_store::yaml;
use strat_tests::steps::Command;

use crate::pipeline;
use crate::sources::{files, root};

/// README, ARCHITECTURE, the folders' guides and so on; what is recorded in CHANGELOG.md may be gone.
fn guides() -> Vec<(PathBuf, String)> {
    let mut guides = files(&["md"]);
    guides.retain(|(path, _)| !path.ends_with("CHANGELOG.md"));
    guides
}

/// Information string and lines of each fence.
fn fences(text: &str) -> Vec<(&str, Vec<&str>)> {
    let mut found: Vec<(&str, Vec<&str>)> = Vec::new();
    let mut inside = false;
    for line in text.lines() {
        if let Some(mark) = line.trim_start().strip_prefix("```") {
            if !inside {
                found.push((mark, Vec::new()));
            }
            inside = !inside;
        } else if inside {
            found.last_mut().expect("a fence").1.push(line);
        }
    }
    found
}

/// Words of each command in lines of a shell, without comments.
fn commands<'a>(lines: &[&'a str]) -> Vec<Vec<&'a str>> {
    lines
        .iter()
        .flat_map(|line| line.split("  #").next().unwrap_or_default().split(" && "))
        .map(|command| command.split_whitespace().collect::<Vec<_>>())
        .filter(|words| !words.is_empty())
        .collect()
}

fn program(name: &str) -> Option<(Command, clap::Command)> {
    match name {
        "prep" => Some((Command::Prep, strat_prep::cli::command())),
        "train" => Some((Command::Train, strat_train::cli::command())),
        "bench" => Some((Command::Bench, strat_bench::cli::command())),
        _ => None,
    }
}

fn assert_parses(words: &[&str], whence: &str) {
    let (_, parser) =
        program(words[0]).unwrap_or_else(|| panic!("{whence}: {words:?} is no command of ours"));
    if let Err(error) = parser.try_get_matches_from(words) {
        assert_eq!(error.exit_code(), 0, "{whence}: {words:?}\n{error}");
    }
}

fn assert_loads(kind: &str, text: &str, whence: &str) {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let file = folder.path().join("description.yaml");
    std::fs::write(&file, text).expect("a file");
    let loaded = match kind {
        "model" => yaml::load::<Description>(&file).map(|_| ()),
        "predictions" => yaml::load::<SavedDescription>(&file).map(|_| ()),
        "protocol" => strat_bench::protocol_file::load(&file)
            .map(|_| ())
            .map_err(|error| panic!("{whence}: {error}")),
        "sprites" => yaml::load::<SpriteFile>(&file).map(|_| ()),
        _ => panic!("{whence}: `yaml {kind}` is no kind of description"),
    };
    loaded.unwrap_or_else(|error| panic!("{whence}: {error}"));
}

#[test]
fn fences_hold_what_the_programs_accept() {
    let (mut parsed, mut loaded) = (0, 0);
    for (path, text) in guides() {
        let whence = path.display().to_string();
        for (info, lines) in fences(&text) {
            match info.split_once(' ').unwrap_or((info, "")) {
                ("sh", "" | "run") => {
                    for words in commands(&lines) {
                        assert_parses(&words, &whence);
                        parsed += 1;
                    }
                }
                ("sh", why) => assert!(why.starts_with("not run: "), "{whence}: `sh {why}`"),
                ("yaml", kind) => {
                    assert_loads(kind, &lines.join("\n"), &whence);
                    loaded += 1;
                }
                // Python is compiled by the tests of the package.
                ("text" | "python", "") => {}
                _ => panic!(
                    "{whence}: a fence is marked `{info}`, which is none of sh, yaml, python and text"
                ),
            }
        }
        // In running text only the options are checked: the rest may be left out.
        for span in text.split('`').skip(1).step_by(2) {
            let mut words: Vec<&str> = span.split_whitespace().collect();
            if words.len() > 1 && program(words[0]).is_some() && !span.contains("...") {
                words.push("--help");
                assert_parses(&words, &whence);
            }
        }
    }
    assert!(
        parsed >= 25 && loaded >= 2,
        "{parsed} commands, {loaded} descriptions"
    );
}

/// The text below the options of a command, and of all commands below it.
fn help_texts(command: &clap::Command) -> Vec<String> {
    let own = [command.get_after_help(), command.get_after_long_help()];
    let mut texts: Vec<String> = own.into_iter().flatten().map(ToString::to_string).collect();
    texts.extend(command.get_subcommands().flat_map(help_texts));
    texts
}

#[test]
fn examples_in_the_help_are_accepted() {
    let (mut parsed, mut loaded) = (0, 0);
    for name in ["prep", "train", "bench"] {
        for text in help_texts(&program(name).expect("a program").1) {
            for line in text.lines() {
                // What stands behind two spaces explains.
                let Some(example) = line
                    .strip_prefix("  ")
                    .and_then(|line| line.split("  ").next())
                else {
                    continue;
                };
                let words: Vec<&str> = example.split_whitespace().collect();
                if words.first() == Some(&name) {
                    assert_parses(&words, &format!("{name} --help"));
                    parsed += 1;
                }
            }
            for (key, kind) in [("\n  input:", "model"), ("\n  meaning:", "predictions")] {
                let Some(at) = text.find(key) else { continue };
                let lines = text[at + 1..]
                    .lines()
                    .map_while(|line| line.strip_prefix("  "));
                assert_loads(
                    kind,
                    &lines.collect::<Vec<_>>().join("\n"),
                    &format!("{name} --help"),
                );
                loaded += 1;
            }
        }
    }
    assert!(
        parsed >= 40 && loaded == 2,
        "{parsed} commands, {loaded} descriptions"
    );
}

#[test]
fn every_subcommand_has_two_examples_of_its_own() {
    for name in ["prep", "train", "bench"] {
        let (_, parser) = program(name).expect("a program");
        for one in parser.get_subcommands().filter(|one| !one.is_hide_set()) {
            let help = one
                .get_after_help()
                .map(ToString::to_string)
                .unwrap_or_default();
            let begins = format!("  {name} ");
            let count = help
                .lines()
                .filter(|line| line.starts_with(&begins))
                .count();
            assert!(
                count >= 2,
                "{name} {} --help has {count} examples",
                one.get_name()
            );
        }
    }
}

/// A word with its path, if it has one, moved to where the test keeps it.
fn moved(word: &str, folder: &Path) -> OsString {
    let (name, path) = word
        .split_once('=')
        .map_or(("", word), |(name, path)| (name, path));
    let world = folder.join("world");
    let path = match path {
        "KITTI/raw" => world.join("kitti_raw"),
        "KITTI/2015" | "KITTI/semantics" => world.join("kitti2015"),
        _ if path.contains('/') => folder.join(path),
        _ => return word.into(),
    };
    let mut found = OsString::from(name);
    if !name.is_empty() {
        found.push("=");
    }
    found.push(path);
    found
}

#[test]
fn the_commands_of_the_readme_run_on_a_rendered_world() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let world = folder.path().join("world");
    let synth = ["synth", "--preset", "tiny", "--quiet", "--out"].map(OsString::from);
    assert_eq!(
        Command::Prep.run(&[&synth[..], &[world.into()]].concat()),
        0
    );
    let text = std::fs::read_to_string(root().join("README.md")).expect("README.md");
    let mut run = 0;
    for (_, lines) in fences(&text)
        .into_iter()
        .filter(|(info, _)| *info == "sh run")
    {
        for words in commands(&lines) {
            let (program, _) = program(words[0]).expect("parsed by another test");
            let mut line: Vec<OsString> = words[1..]
                .iter()
                .map(|word| moved(word, folder.path()))
                .collect();
            match program {
                Command::Prep => line.extend(["--allow-missing", "--quiet"].map(OsString::from)),
                Command::Train => line.extend(pipeline::small_training()),
                Command::Bench => {
                    line.extend(["--runtime", "embedded", "--quiet"].map(OsString::from))
                }
            }
            assert_eq!(program.run(&line), 0, "{words:?}");
            run += 1;
        }
    }
    assert_eq!(run, 3, "the README's three commands");
    let table = folder.path().join("results/kitti/table_3_1.txt");
    assert!(
        std::fs::read_to_string(table)
            .expect("a table")
            .contains("of 200 images")
    );
}

#[test]
fn links_lead_to_files() {
    for (path, text) in guides() {
        let folder = root().join(path.parent().expect("a folder"));
        for link in text
            .split("](")
            .skip(1)
            .filter_map(|rest| rest.split(')').next())
        {
            let file = link.split('#').next().unwrap_or_default();
            let inside = !link.contains("://") && !file.is_empty() && !file.contains(' ');
            assert!(
                !inside || folder.join(file).exists(),
                "{} links to {link}",
                path.display()
            );
        }
    }
}

/// A table of ARCHITECTURE.md that begins with a folder has a line for each folder in it, and no other.
#[test]
fn every_room_has_its_line() {
    let text = std::fs::read_to_string(root().join("ARCHITECTURE.md")).expect("ARCHITECTURE.md");
    let mut tables = 0;
    for table in text
        .split("\n\n")
        .filter(|block| block.starts_with("| `") && block.contains("/` | |"))
    {
        let spans = |line: &str| -> Vec<String> {
            let cell = line.split('|').nth(1).unwrap_or_default();
            cell.split('`')
                .skip(1)
                .step_by(2)
                .map(str::to_owned)
                .collect()
        };
        let base = root().join(&spans(table)[0]);
        let named: Vec<String> = table.lines().skip(2).flat_map(spans).collect();
        for name in &named {
            assert!(base.join(name).exists(), "{} has no {name}", base.display());
        }
        for entry in std::fs::read_dir(&base)
            .expect("a folder")
            .map(|entry| entry.expect("an entry"))
        {
            let name = format!("{}/", entry.file_name().to_string_lossy());
            let is_room = entry.path().is_dir();
            assert!(
                !is_room || named.contains(&name),
                "{name} of {} has no line",
                base.display()
            );
        }
        tables += 1;
    }
    assert_eq!(tables, 5, "prep, train, bench, leaderboard and metrics");
}

#[test]
fn messages_in_the_guide_to_wrong_numbers_are_those_of_the_code() {
    let joined = |text: &str| {
        // A string literal that goes on in the next line.
        let pieces: Vec<&str> = text.split("\\\n").collect();
        let mut whole = pieces[0].to_owned();
        pieces[1..]
            .iter()
            .for_each(|piece| whole.push_str(piece.trim_start()));
        whole
    };
    let mut code = files(&["rs"]);
    code.retain(|(path, _)| !path.starts_with("tests"));
    let code: Vec<String> = code.iter().map(|(_, text)| joined(text)).collect();
    let guide = std::fs::read_to_string(root().join("bench/FOOTGUNS.md")).expect("FOOTGUNS.md");
    let mut count = 0;
    for message in guide.lines().filter_map(|line| line.strip_prefix("> ")) {
        for piece in message
            .split("...")
            .map(str::trim)
            .filter(|piece| !piece.is_empty())
        {
            assert!(
                code.iter().any(|text| text.contains(piece)),
                "no message says \"{piece}\""
            );
            count += 1;
        }
    }
    assert!(count >= 15, "{count} pieces of messages");
}
