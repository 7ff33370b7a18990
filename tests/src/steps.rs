//! The demo as a list of command lines.
//!
//! The order and the arguments are those of the README's walk through real KITTI;
//! only the folders differ. Not here: any of the work itself, which the three
//! commands do, and the choice of the trained model's size, which is the
//! configuration `demo` of `train`.

use std::ffi::OsString;
use std::path::{Path, PathBuf};

/// One command line of the demo, and what it is for.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Step {
    /// What the step does, for the heading above its output.
    pub title: &'static str,
    /// Which command: its name is the first word of the line shown.
    pub command: Command,
    /// Arguments after the command's name.
    pub arguments: Vec<OsString>,
}

/// The three commands.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Command {
    /// `prep`
    Prep,
    /// `train`
    Train,
    /// `bench`
    Bench,
}

impl Command {
    /// The binary's name.
    pub fn name(self) -> &'static str {
        match self {
            Command::Prep => "prep",
            Command::Train => "train",
            Command::Bench => "bench",
        }
    }

    /// Runs the command in this process and returns its exit code.
    pub fn run(self, arguments: &[OsString]) -> u8 {
        let line = std::iter::once(OsString::from(self.name())).chain(arguments.iter().cloned());
        match self {
            Command::Prep => strat_prep::cli::main(line),
            Command::Train => strat_train::cli::main(line),
            Command::Bench => strat_bench::cli::main(line),
        }
    }
}

impl Step {
    /// The line as a user would type it.
    pub fn line(&self) -> String {
        let mut line = self.command.name().to_owned();
        for argument in &self.arguments {
            line.push(' ');
            let text = argument.to_string_lossy();
            if text.contains(char::is_whitespace) {
                line.push_str(&format!("'{text}'"));
            } else {
                line.push_str(&text);
            }
        }
        line
    }
}

/// What the demo runs: the world's size and the training configuration.
#[derive(Debug, Clone)]
pub struct Plan {
    /// Folder for everything the demo writes.
    pub out: PathBuf,
    /// Preset of `prep synth`.
    pub world: String,
    /// Configuration of `train`, by name or path.
    pub config: String,
    /// Further arguments for `train`.
    pub train_arguments: Vec<OsString>,
    /// Further arguments for each `bench`.
    pub bench_arguments: Vec<OsString>,
}

/// Words and paths as one argument list.
macro_rules! arguments {
    ($($word:expr),* $(,)?) => { vec![$(OsString::from(AsRef::<std::ffi::OsStr>::as_ref(&$word))),*] };
}

impl Plan {
    /// Where the tables of the Eigen split are written.
    pub fn eigen_results(&self) -> PathBuf {
        self.out.join("results").join("eigen")
    }

    /// The page about all results.
    pub fn report(&self) -> PathBuf {
        self.out.join("results").join("report.html")
    }

    /// Where the tables of the KITTI split are written.
    pub fn kitti_results(&self) -> PathBuf {
        self.out.join("results").join("kitti")
    }

    /// All steps, in order.
    pub fn steps(&self) -> Vec<Step> {
        let at = |name: &str| -> PathBuf { self.out.join(name) };
        let raw = at("world").join("kitti_raw");
        let stereo = at("world").join("kitti2015");
        let model = at("run").join("model.onnx");
        let prepare = |split: &str, rest: &[(&str, &Path)]| {
            let mut list = arguments![split, "--raw", raw];
            for (flag, folder) in rest {
                list.extend(arguments![flag, folder]);
            }
            list.extend(arguments![
                "--allow-missing",
                "--train-depth",
                "--out",
                at(split)
            ]);
            Step {
                title: "prepare a split",
                command: Command::Prep,
                arguments: list,
            }
        };
        let bench = |table: &str, data: &str, by_distance: &str, out: PathBuf| {
            let mut list = arguments!["--table", table, "--data", at(data), "--model"];
            let mut named = OsString::from("StrAT=");
            named.push(&model);
            list.push(named);
            list.extend(arguments![
                "--median-baseline",
                "--protocol",
                by_distance,
                "--extremes",
                "3",
                "--out",
                out
            ]);
            list.extend(self.bench_arguments.iter().cloned());
            Step {
                title: "evaluate",
                command: Command::Bench,
                arguments: list,
            }
        };
        let mut train = arguments![
            "--config",
            self.config,
            "--data",
            at("eigen"),
            "--out",
            at("run")
        ];
        train.extend(self.train_arguments.iter().cloned());
        vec![
            Step {
                title: "render a street world in KITTI's layouts",
                command: Command::Prep,
                arguments: arguments!["synth", "--preset", self.world, "--out", at("world")],
            },
            prepare(
                "kitti",
                &[
                    ("--stereo2015", stereo.as_path()),
                    ("--semantics", stereo.as_path()),
                ],
            ),
            prepare("eigen", &[]),
            Step {
                title: "train the structured adversarial model and export it",
                command: Command::Train,
                arguments: train,
            },
            bench("all", "kitti", "kitti2015-distance", self.kitti_results()),
            bench("3.3", "eigen", "eigen-80-distance", self.eigen_results()),
            Step {
                title: "put everything on one page",
                command: Command::Bench,
                arguments: arguments!["report", at("results")],
            },
        ]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lines_can_be_typed() {
        let plan = Plan {
            out: PathBuf::from("a b"),
            world: "tiny".into(),
            config: "demo".into(),
            train_arguments: vec!["--max-steps".into(), "3".into()],
            bench_arguments: Vec::new(),
        };
        let lines: Vec<String> = plan.steps().iter().map(Step::line).collect();
        assert_eq!(
            lines[0], "prep synth --preset tiny --out 'a b/world'",
            "a folder with a space is quoted"
        );
        assert!(lines[3].ends_with("--out 'a b/run' --max-steps 3"));
        assert_eq!(lines.last().unwrap(), "bench report 'a b/results'");
        assert_eq!(lines.len(), 7);
    }
}
