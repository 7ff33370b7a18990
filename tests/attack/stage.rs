//! What the attacks are made on: a rendered world, two sets, a trained network, and the three commands as
//! processes of their own under limits.

use std::collections::BTreeMap;
use std::fs;
use std::os::unix::process::ExitStatusExt;
use std::path::{Path, PathBuf};
use std::process::Command;

use strat_store::fault;

/// Address space a process may have, in KiB, and the seconds after which it counts as hanging.
const MEMORY_KIB: u32 = 6 << 20;
const SECONDS: u32 = 60;

/// Exit code of `timeout` for a process that it had to end.
const HANGING: i32 = 124;

/// Most stages side by side.
const MOST_STAGES: usize = 8;

/// Where [`Stage::keep`] puts what it keeps.
const KEPT: &str = "kept";

/// Copies a folder or a file with times and empty folders.
fn copy_whole(from: &Path, to: &Path) {
    let copied = Command::new("cp").arg("-a").args([from, to]).status();
    assert!(
        copied.is_ok_and(|status| status.success()),
        "{} is copied",
        from.display()
    );
}

/// A folder with everything that attacks need, made by the commands themselves.
pub struct Stage {
    folder: tempfile::TempDir,
}

/// What a process said and how it ended.
pub struct Ended {
    pub code: i32,
    pub stderr: String,
}

impl Ended {
    /// How a process must never end, whatever it was given.
    pub fn crime(&self) -> Option<String> {
        let is_silent = self.code != 0 && self.stderr.trim().is_empty();
        let silence = is_silent.then(|| "no word about why it failed".to_owned());
        self.crime_but_silence().or(silence)
    }

    /// Like [`Ended::crime`] where nothing of what it says can be heard.
    pub fn crime_but_silence(&self) -> Option<String> {
        let what = match self.code {
            HANGING => format!("still running after {SECONDS} s"),
            101 => "a panic".to_owned(),
            code if code > 128 => format!("signal {}", code - 128),
            code if !(0..=2).contains(&code) => format!("exit code {code}"),
            _ if self.stderr.contains("panicked") => "a panic".to_owned(),
            _ => return None,
        };
        Some(format!("{what}: {}", self.stderr.trim()))
    }
}

/// A fault to meet: at which change, and the error or the signal; without one, the process ends there.
#[derive(Clone, Copy)]
pub struct Fault {
    pub at: u64,
    pub what: Option<&'static str>,
}

impl Fault {
    pub fn is_error(&self) -> bool {
        let is = |what| fault::ERRORS.iter().any(|(error, _)| *error == what);
        self.what.is_some_and(is)
    }

    pub fn is_signal(&self) -> bool {
        self.what.is_some_and(|what| fault::SIGNALS.contains(&what))
    }
}

impl Stage {
    pub fn new() -> Self {
        let stage = Self {
            folder: tempfile::tempdir().expect("a folder for the attacks"),
        };
        let size = "--width 128 --height 64 --jobs 2 --quiet --allow-missing";
        let raw = "--raw world/kitti_raw";
        for line in [
            "prep synth --preset tiny --quiet --out world".to_owned(),
            format!("prep eigen {raw} {size} --out eigen"),
            format!(
                "prep kitti {raw} --stereo2015 world/kitti2015 --train-depth {size} --out kitti"
            ),
        ] {
            stage.must(&line);
        }
        stage.own_pairs();
        stage.must("prep pairs --csv pairs.csv --width 128 --height 64 --quiet --out own");
        stage.must(&format!("train {TRAINING} --out trained"));
        stage.copy("trained/model.onnx", "a.onnx");
        stage.must(&format!(
            "train {TRAINING} --out other --set seed=4 --set max_steps=2"
        ));
        stage.copy("other/model.onnx", "b.onnx");
        stage.write("study.yaml", STUDY.as_bytes());
        stage
    }

    /// One for each processor, but for few of many: they hold two sets and a world each.
    pub fn several() -> Vec<Self> {
        let count = std::thread::available_parallelism().map_or(1, usize::from);
        let mut stages = vec![Self::new()];
        while stages.len() < count.min(MOST_STAGES) {
            stages.push(stages[0].twin());
        }
        stages
    }

    /// The same in another folder, for attacks side by side.
    fn twin(&self) -> Self {
        let twin = Self {
            folder: tempfile::tempdir().expect("a folder for the attacks"),
        };
        copy_whole(&self.path("."), twin.folder.path());
        twin
    }

    /// Says of a submission what its contributor has to, where it is there.
    pub fn fill_in(&self, card: &str) {
        if let Ok(text) = fs::read_to_string(self.path(card)) {
            self.write(card, text.replace("fill in", "A. Person").as_bytes());
        }
    }

    /// Keeps folders as they are, for [`Stage::restore`].
    pub fn keep(&self, names: &[&str]) {
        self.remove(KEPT);
        fs::create_dir(self.path(KEPT)).expect("a folder");
        for name in names.iter().filter(|name| self.path(name).exists()) {
            copy_whole(&self.path(name), &self.path(&format!("{KEPT}/{name}")));
        }
    }

    /// Makes folders what they were, with the times of their files.
    pub fn restore(&self, names: &[&str]) {
        names.iter().for_each(|name| self.remove(name));
        copy_whole(&self.path(&format!("{KEPT}/.")), &self.path("."));
    }

    /// A list of pairs of the rendered images, six of them for testing, and photos.
    fn own_pairs(&self) {
        let images = |side: u8| -> Vec<PathBuf> {
            let at = format!("image_0{side}/data");
            let world = self.path("world/kitti_raw");
            let files = tree(&world).into_keys();
            files
                .filter(|path| path.parent().is_some_and(|folder| folder.ends_with(&at)))
                .collect()
        };
        let mut list = "left,right,focal_px,baseline_m,split\n".to_owned();
        for (number, (left, right)) in images(2).iter().zip(&images(3)).take(8).enumerate() {
            let split = if number < 2 { "train" } else { "test" };
            let [left, right] =
                [left, right].map(|path| format!("world/kitti_raw/{}", path.display()));
            list += &format!("{left},{right},240,0.54,{split}\n");
            if number < 3 {
                self.copy(&left, &format!("photos/{number}.png"));
            }
        }
        self.write("pairs.csv", list.as_bytes());
    }

    pub fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    pub fn write(&self, name: &str, bytes: &[u8]) {
        let path = self.path(name);
        fs::create_dir_all(path.parent().expect("a folder")).expect("a folder");
        fs::write(path, bytes).expect("a file");
    }

    pub fn read(&self, name: &str) -> Vec<u8> {
        fs::read(self.path(name)).unwrap_or_else(|error| panic!("{name}: {error}"))
    }

    pub fn copy(&self, from: &str, to: &str) {
        self.write(to, &self.read(from));
    }

    pub fn remove(&self, name: &str) {
        let path = self.path(name);
        if path.is_dir() {
            fs::remove_dir_all(path).expect("a folder that can be removed");
        } else {
            let _ = fs::remove_file(path);
        }
    }

    /// Runs a line as typed, in the folder of the stage.
    pub fn run(&self, line: &str, fault: Option<Fault>) -> Ended {
        self.spawn("exec", line, "", fault)
    }

    /// Runs a line between other words of the shell.
    pub fn run_in_shell(&self, before: &str, line: &str, after: &str) -> Ended {
        self.spawn(before, line, after, None)
    }

    fn spawn(&self, before: &str, line: &str, after: &str, fault: Option<Fault>) -> Ended {
        let limited =
            format!("ulimit -c 0; ulimit -v {MEMORY_KIB}; {before} \"$0\" \"$@\" {after}");
        let mut command = Command::new("timeout");
        command
            .args(["-k", "1", &SECONDS.to_string(), "sh", "-c", &limited])
            .arg(std::env::current_exe().expect("this program"))
            .args(line.split_whitespace())
            .current_dir(self.folder.path())
            .env("RAYON_NUM_THREADS", "2")
            .env_remove(fault::AT)
            .env_remove(fault::ERROR);
        if let Some(Fault { at, what }) = fault {
            command.env(fault::AT, at.to_string());
            command.envs(what.map(|what| (fault::ERROR, what)));
        }
        let output = command.output().expect("timeout, of coreutils");
        Ended {
            // `timeout` ends itself by the signal that ended the process.
            code: output
                .status
                .code()
                .unwrap_or_else(|| 128 + output.status.signal().unwrap_or_default()),
            stderr: String::from_utf8_lossy(&output.stderr).into_owned(),
        }
    }

    /// Runs a line that has to succeed, and counts the changes of the process that makes most of them: each
    /// counts its own.
    pub fn count(&self, line: &str) -> u64 {
        self.remove("changes");
        let before = format!("export {}=changes; exec", fault::CHANGES);
        let ended = self.spawn(&before, line, "", None);
        assert!(ended.code == 0, "{line}: {}: {}", ended.code, ended.stderr);
        let mut by_process: BTreeMap<String, u64> = BTreeMap::new();
        let made = fs::read_to_string(self.path("changes")).unwrap_or_default();
        for process in made.lines() {
            *by_process.entry(process.to_owned()).or_default() += 1;
        }
        by_process.into_values().max().unwrap_or_default()
    }

    /// What is half-written below a folder.
    pub fn leftovers(&self, name: &str) -> Vec<PathBuf> {
        let mut found: Vec<PathBuf> = tree(&self.path(name)).into_keys().collect();
        found.retain(|path| {
            let name = path.file_name().unwrap_or_default().to_string_lossy();
            strat_store::files::is_leftover(&name)
        });
        found
    }

    /// Runs a line that has to succeed.
    pub fn must(&self, line: &str) {
        let ended = self.run(line, None);
        assert!(ended.code == 0, "{line}: {}: {}", ended.code, ended.stderr);
    }
}

/// A training of two steps.
pub const TRAINING: &str = "--config kitti-strat --preset tiny --quiet --data kitti \
    --set network.width=1/32 --set discriminator.width=1/16 --set batch=2 --set epochs=2 \
    --set pictures.every=1 --set checkpoint.every=1 --set max_steps=6";

/// Two such trainings.
const STUDY: &str = "base: kitti-strat\npreset: tiny\n\
    settings: {network.width: 1/32, discriminator.width: 1/16, batch: 2, epochs: 1, max_steps: 2, \
    checkpoint.every: 1}\n\
    variants: {strat: {variant: strat}, no-adv: {variant: no-adv}}\nseeds: [1]\n";

/// All files below a folder by their paths in it.
pub fn tree(root: &Path) -> BTreeMap<PathBuf, Vec<u8>> {
    let mut found = BTreeMap::new();
    let mut folders = vec![root.to_path_buf()];
    while let Some(folder) = folders.pop() {
        for entry in fs::read_dir(&folder).into_iter().flatten().flatten() {
            let path = entry.path();
            if path.is_dir() {
                folders.push(path);
            } else {
                let bytes = fs::read(&path).unwrap_or_default();
                let name = path.strip_prefix(root).unwrap_or(&path).to_path_buf();
                found.insert(name, bytes);
            }
        }
    }
    found
}
