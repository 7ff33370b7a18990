//! `bench latency` from outside. Nothing here depends on how fast the machine is.

use std::{
    fs,
    path::{Path, PathBuf},
};

use strat_bench::latency::{self, LatencyRow, Scenario, Stage};
use strat_onnx::metadata::Probe;
use strat_splits::Split;

use crate::broken::{Fault, fix_batch, write_spoilt};
use crate::command::{Ran, bench};
use crate::fixtures::{
    INPUT_HEIGHT, INPUT_WIDTH, metadata, network, onnxruntime, write_model, write_set,
};

struct World {
    folder: tempfile::TempDir,
}

impl World {
    fn new() -> Self {
        let folder = tempfile::tempdir().unwrap();
        write_set(&folder.path().join("set"), Split::Kitti, 3, false);
        Self { folder }
    }

    fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    fn model(&self) -> String {
        let path = write_model(self.folder.path(), "looks", 0.02, 0.05, "kitti");
        path.to_str().unwrap().to_owned()
    }

    /// As short as it gets, with the embedded runtime.
    fn latency(&self, source: [&str; 2], model: &str, more: &[&str]) -> Ran {
        let (out, folder) = (self.path("out"), self.path(source[1]));
        let mut arguments = vec!["latency", "--model", model, source[0]];
        arguments.extend([folder.to_str().unwrap(), "--out", out.to_str().unwrap()]);
        arguments.extend(["--seconds", "0", "--queries", "3"]);
        if !more.contains(&"--runtime") {
            arguments.extend(["--runtime", "embedded"]);
        }
        arguments.extend(more);
        bench(&arguments)
    }

    fn rows(&self) -> Vec<LatencyRow> {
        latency::read_rows(fs::File::open(self.path("out/latency.csv")).unwrap()).unwrap()
    }
}

const SET: [&str; 2] = ["--data", "set"];

#[test]
fn every_combination_has_its_rows() {
    let world = World::new();
    let model = world.model();
    let ran = world.latency(SET, &model, &["--threads", "1,2,1", "--batch", "1,2"]);
    ran.code(0).says("below 100 queries");
    for word in [
        "p99",
        "single_stream",
        "multi_stream",
        "file_to_depth",
        "images/s",
    ] {
        assert!(ran.out.contains(word), "no {word} in {}", ran.out);
    }
    let rows = world.rows();
    assert_eq!(rows.len(), 2 * 2 * 4);
    for threads in [1, 2] {
        for batch in [1, 2] {
            for stage in [Stage::Session, Stage::FileToDepth] {
                let found: Vec<&LatencyRow> = rows
                    .iter()
                    .filter(|row| (row.threads, row.batch, row.stage) == (threads, batch, stage))
                    .collect();
                let stream = if batch == 1 {
                    Scenario::SingleStream
                } else {
                    Scenario::MultiStream
                };
                assert_eq!(found[0].scenario, stream);
                assert_eq!(found[1].scenario, Scenario::Offline);
                assert_eq!(found.len(), 2);
                assert_eq!(found[0].queries, 3);
                assert_eq!(found[0].images, 3 * batch as u64);
                assert!(found[1].images >= 3);
            }
        }
    }
    for row in &rows {
        assert_eq!(row.format, latency::FORMAT);
        assert_eq!(row.provider, "rten CPU");
        assert_eq!(row.model_hash.len(), 64);
        assert_eq!(row.samples, 3);
        assert!(row.max_difference <= latency::AGREEMENT);
        assert!((row.images_per_second * row.seconds / row.images as f64 - 1.0).abs() < 1e-6);
        let Some(mean) = row.mean_ms else {
            assert_eq!((row.scenario, row.p99_ms), (Scenario::Offline, None));
            continue;
        };
        let ordered = [
            row.min_ms, row.p50_ms, row.p90_ms, row.p95_ms, row.p99_ms, row.max_ms,
        ];
        assert!(ordered.is_sorted(), "{row:?}");
        assert!(
            row.min_ms <= Some(mean) && Some(mean) <= row.max_ms,
            "{row:?}"
        );
        // The latencies of queries one after the other fill the measurement.
        assert!(mean * row.queries as f64 <= row.seconds * 1e3 + 1e-6);
    }
}

#[test]
fn without_a_camera_the_stage_is_called_disparity() {
    let world = World::new();
    let model = world.model();
    world.latency(["--images", "set/f"], &model, &[]).code(0);
    assert!(
        world
            .rows()
            .iter()
            .any(|row| row.stage == Stage::FileToDisparity)
    );
    let camera = ["--focal-px", "72", "--baseline-m", "0.5"];
    world
        .latency(["--images", "set/f"], &model, &camera)
        .code(0);
    assert!(
        world
            .rows()
            .iter()
            .any(|row| row.stage == Stage::FileToDepth)
    );
    fs::create_dir(world.path("empty")).unwrap();
    world
        .latency(["--images", "empty"], &model, &[])
        .code(2)
        .says("no PNG or JPEG images");
    for wrong in [["--seconds", "-1"], ["--batch", "0"], ["--threads", "x"]] {
        world.latency(SET, &model, &wrong).code(2);
    }
}

/// A network whose answer depends on its neighbours in the batch.
#[test]
fn what_predicts_something_else_in_a_batch_is_not_timed() {
    let world = World::new();
    let model = write_spoilt(
        world.folder.path(),
        "mixes",
        &metadata("kitti"),
        Fault::MixesBatch,
    );
    let ran = world.latency(SET, &model, &["--batch", "1,3"]);
    ran.code(1).says("batch 3").says("is not timed");
    let rows = world.rows();
    assert!(!rows.is_empty() && rows.iter().all(|row| row.batch == 1));
}

#[test]
fn a_batch_that_fails_is_a_sentence() {
    let mut runtimes = vec!["embedded"];
    runtimes.extend(onnxruntime().map(|_| "ort"));
    for runtime in runtimes {
        let world = World::new();
        let shape = [1, 2, i64::from(INPUT_HEIGHT), i64::from(INPUT_WIDTH)];
        let fault = Fault::Reshape(shape);
        let model = write_spoilt(world.folder.path(), "one", &metadata("kitti"), fault);
        let more = ["--batch", "1,2", "--runtime", runtime];
        let ran = world.latency(SET, &model, &more);
        eprintln!("{runtime}: {}", ran.err);
        ran.code(1).says("batch 2: ");
        assert!(!ran.err.contains(".cc:"), "{}", ran.err);
        assert!(world.rows().iter().all(|row| row.batch == 1));
    }
}

#[test]
fn a_fixed_batch_is_said() {
    let world = World::new();
    let mut metadata = metadata("kitti");
    metadata.probe = None;
    let path = world.path("fixed.onnx");
    fs::write(&path, fix_batch(&network(0.04, 0.1, Some(&metadata)))).unwrap();
    let ran = world.latency(SET, path.to_str().unwrap(), &["--batch", "1,4"]);
    ran.code(0).says("fixed batch of 1");
    assert!(world.rows().iter().all(|row| row.batch == 1));
}

#[test]
fn a_wrong_probe_or_image_stops_the_clock() {
    let world = World::new();
    let mut metadata = metadata("kitti");
    let plane = 2 * (INPUT_WIDTH * INPUT_HEIGHT) as usize;
    let wrong = vec![0.2; plane];
    metadata.probe = Some(Probe::record(INPUT_WIDTH, INPUT_HEIGHT, &wrong).unwrap());
    let path = world.path("wrong.onnx");
    fs::write(&path, network(0.04, 0.0, Some(&metadata))).unwrap();
    let ran = world.latency(SET, path.to_str().unwrap(), &[]);
    ran.code(1)
        .says("the trainer's own output")
        .says("latency.csv was not written");
    assert!(!world.path("out/latency.csv").exists());

    let image = first_file(&world.path("set/f"));
    let bytes = fs::read(&image).unwrap();
    fs::write(&image, &bytes[..bytes.len() / 2]).unwrap();
    let ran = world.latency(SET, &world.model(), &[]);
    ran.code(1).says("it is truncated");
}

fn first_file(folder: &Path) -> PathBuf {
    let mut files: Vec<PathBuf> = fs::read_dir(folder)
        .unwrap()
        .map(|entry| entry.unwrap().path())
        .collect();
    files.sort();
    files.remove(0)
}
