//! A leaderboard over 59 images of the Eigen test, and submissions with rows that `strat-metrics`
//! has measured on two pixels an image.

use std::fs;
use std::path::{Path, PathBuf};

use strat_leaderboard::check::{Checked, check};
use strat_leaderboard::publish::publish;
use strat_metrics::{
    GroundTruth, KnownCamera, Row, RowContext, StereoCamera, evaluate_depth, protocol, rows,
};
use strat_splits::{Split, test_ids};
use tempfile::TempDir;

pub const PROTOCOL: &str = "eigen-80-nocrop";

/// Digest of the data set.
pub fn data_digest() -> String {
    "0f".repeat(32)
}

/// Every twelfth image of the Eigen test: all 28 drives, two or three of each.
pub fn images() -> Vec<String> {
    test_ids(Split::Eigen).into_iter().step_by(12).collect()
}

pub struct Fixture {
    pub folder: TempDir,
    /// Images of the set, and of the published test set of its split.
    counts: (usize, usize),
}

impl Fixture {
    pub fn new() -> Self {
        Self::of_source("kitti")
    }

    pub fn of_source(source: &str) -> Self {
        Self::of_images(source, "eigen", &images())
    }

    pub fn of_images(source: &str, split: &str, images: &[String]) -> Self {
        let of_split = match split {
            "eigen" => test_ids(Split::Eigen).len(),
            _ => images.len(),
        };
        let fixture = Self {
            folder: tempfile::tempdir().unwrap(),
            counts: (images.len(), of_split),
        };
        let text = format!(
            "strat_leaderboard: 1\ntitle: Test board\ndata:\n  - {{digest: {}, name: A set, source: {source}, \
             split: {split}, images: {}}}\n",
            data_digest(),
            images.len()
        );
        fixture.write("board/leaderboard.yaml", &text);
        fs::create_dir_all(fixture.path("board/submissions")).unwrap();
        fixture
    }

    pub fn path(&self, path: &str) -> PathBuf {
        self.folder.path().join(path)
    }

    pub fn own(&self, id: &str, file: &str) -> PathBuf {
        self.path("board/submissions").join(id).join(file)
    }

    pub fn write(&self, path: &str, text: &str) {
        let path = self.path(path);
        fs::create_dir_all(path.parent().unwrap()).unwrap();
        fs::write(path, text).unwrap();
    }

    /// Replaces a text in a file of a submission, which must be there.
    pub fn edit(&self, id: &str, file: &str, from: &str, to: &str) {
        let path = self.own(id, file);
        let text = fs::read_to_string(&path).unwrap();
        assert!(text.contains(from), "{from} is not in {text}");
        fs::write(path, text.replacen(from, to, 1)).unwrap();
    }

    /// Leaves the rows plain, for tests that edit them.
    pub fn unpack(&self, id: &str) {
        let packed = fs::read(self.own(id, "rows.csv.gz")).unwrap();
        let mut text = String::new();
        let mut file = flate2::read::GzDecoder::new(packed.as_slice());
        std::io::Read::read_to_string(&mut file, &mut text).unwrap();
        fs::write(self.own(id, "rows.csv"), text).unwrap();
        fs::remove_file(self.own(id, "rows.csv.gz")).unwrap();
    }

    /// Results of a run: rows and its record, in a folder of the model's name.
    pub fn results(&self, model: &str, rows_of: &[Row], metadata: &str, warnings: &str) -> PathBuf {
        let mut bytes = Vec::new();
        rows::write(rows_of, &mut bytes).unwrap();
        self.write(
            &format!("results/{model}/rows.csv"),
            &String::from_utf8(bytes).unwrap(),
        );
        let rules = protocol(PROTOCOL).unwrap();
        let record = format!(
            "tool: bench\ntool_version: 0.1.0\narguments: [--data, /home/somebody/sets/eigen]\n\
             data: {{path: /home/somebody/sets/eigen, source: kitti, data_digest: {}, \
             test_images_expected: {}, test_images_found: {}}}\ndevice: cpu\n\
             models:\n- {{name: {model:?}, file: /home/somebody/m.onnx, blake3: abc, parameters: 7, runtime: embedded, \
             provider: cpu, metadata: {metadata}}}\n\
             protocols: [{{name: {PROTOCOL}, digest: {}}}]\nwarnings: [{warnings}]\nfailures: 0\n",
            data_digest(),
            self.counts.1,
            self.counts.0,
            rules.digest()
        );
        self.write(&format!("results/{model}/run.yaml"), &record);
        self.path(&format!("results/{model}/rows.csv"))
    }

    /// Publishes rows and fills the card in.
    pub fn submit_rows(&self, id: &str, model: &str, rows_of: &[Row]) {
        let metadata = "{split: eigen, train_drives: [2011_09_26_drive_0001], seed: 3}";
        let file = self.results(model, rows_of, metadata, "");
        publish(&file, None, &self.path("board/submissions").join(id)).unwrap();
        self.fill_in(id);
    }

    /// Fills the card in.
    pub fn fill_in(&self, id: &str) {
        let path = self.own(id, "card.yaml");
        let text = fs::read_to_string(&path).unwrap();
        let text = text
            .replace("authors: \"fill in\"", "authors: A. Person")
            .replace("licence: \"fill in\"", "licence: MIT");
        fs::write(path, text).unwrap();
    }

    /// A method whose depth is so many times too large.
    pub fn submit(&self, id: &str, factor: f32) {
        self.submit_rows(id, id, &measured(id, &images(), factor));
    }

    pub fn check(&self) -> Checked {
        check(&self.path("board"), true).unwrap()
    }

    /// The sentences of all problems, one a line.
    pub fn problems(&self) -> String {
        let problems = self.check().problems;
        problems
            .iter()
            .map(|problem| format!("{problem}\n"))
            .collect()
    }

    /// The only problem.
    pub fn problem(&self) -> String {
        let problems = self.check().problems;
        assert_eq!(problems.len(), 1, "{problems:#?}");
        problems[0].to_string()
    }
}

/// Rows of a model with noise of its own on each image.
pub fn measured(model: &str, images: &[String], factor: f32) -> Vec<Row> {
    let rules = protocol(PROTOCOL).unwrap();
    let context = RowContext {
        model: model.to_owned(),
        model_hash: format!("hash of {model}"),
        variant: None,
        protocol: rules.name.clone(),
        protocol_digest: rules.digest(),
        data_digest: data_digest(),
        split: "eigen".to_owned(),
        runtime: "embedded".to_owned(),
        provider: "cpu".to_owned(),
        tool_version: "0.1.0".to_owned(),
    };
    let camera = KnownCamera {
        calibration: StereoCamera {
            focal_px: 700.0,
            baseline_m: 0.5,
        },
        nominal_focal_px: None,
    };
    let noise = |image: &str| {
        let mixed = image
            .bytes()
            .chain(model.bytes())
            .fold(7_u32, |mixed, byte| {
                mixed.wrapping_mul(31).wrapping_add(u32::from(byte))
            });
        (mixed % 1000) as f32 / 1000.0
    };
    let row = |(index, image): (usize, &String)| {
        let truth_m = [10.0 + (index % 7) as f32, 25.0];
        let truth = GroundTruth::new((2, 1), &truth_m, camera).unwrap();
        let predicted = truth_m.map(|depth| depth * factor + 0.3 * noise(image));
        let score = evaluate_depth(&rules, &truth, &predicted).unwrap()[0];
        Row::new(&context, image, score)
    };
    images.iter().enumerate().map(row).collect()
}

pub fn text(path: &Path) -> String {
    fs::read_to_string(path).unwrap()
}
