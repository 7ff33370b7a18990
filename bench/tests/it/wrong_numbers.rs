//! Ways to a wrong number that end in a sentence: descriptions that changed, shapes and values that
//! cannot be what they are said to be, maps with holes.

use std::{fs, path::Path};

use assert_cmd::Command;
use strat_metrics::Row;
use strat_onnx::metadata::{Spread, TrainingCamera};
use strat_splits::Split;

use crate::command::{Ran, run, text};
use crate::fixtures::{
    BASELINE_M, FOCAL_PX, HEIGHT, INPUT_HEIGHT, INPUT_WIDTH, SCAN_DEPTH_M, WIDTH, metadata, network,
};
use crate::npy;
use crate::world::World;

/// True depth along the camera's axis.
const CAMERA_M: f32 = SCAN_DEPTH_M - 0.25;

fn describe(path: &Path, description: &str) {
    fs::write(path.with_extension("yaml"), description).unwrap();
}

/// Saves maps of `rows` x `columns`, one for each image, with their description.
fn save(
    path: &Path,
    (images, rows, columns): (usize, usize, usize),
    value: impl Fn(usize, usize) -> f32,
    description: &str,
) {
    let places =
        (0..images * rows).flat_map(|row| (0..columns).map(move |column| (row % rows, column)));
    let values = places.map(|(row, column)| value(row, column));
    npy::write(path, &[images, rows, columns], values);
    describe(path, description);
}

/// Evaluates saved maps under the protocol whose truth is [`CAMERA_M`] everywhere.
fn evaluate(world: &World, out: &str, path: &Path, more: &[&str]) -> Ran {
    let path = text(path);
    let own = ["--protocol", "eigen-cameraz-80", "--predictions", &path];
    world.bench("3.3", out, &[&own, more].concat())
}

fn under_camera_z(world: &World, out: &str) -> Vec<Row> {
    let mut rows = world.rows(out);
    rows.retain(|row| row.context.protocol == "eigen-cameraz-80");
    rows
}

const SIZE: (usize, usize, usize) = (3, HEIGHT as usize, WIDTH as usize);

#[test]
fn rows_are_identified_by_the_description_too() {
    let world = World::new(Split::Eigen, 3, false);
    let path = world.path("maps.npy");
    let rows_of = |out: &str, description: &str| {
        save(&path, SIZE, |_, _| CAMERA_M, description);
        evaluate(&world, out, &path, &[]).code(0);
        under_camera_z(&world, out)
    };
    let metres = rows_of("metres", "meaning: depth_m\n");
    let scaled = rows_of("scaled", "meaning: depth_m\nscale: 1.5\n");
    assert_ne!(metres[0].context.model_hash, scaled[0].context.model_hash);
    assert!((scaled[0].score.metrics.abs_rel - 0.5).abs() < 1e-6);

    // Two kernels of one file are two models; without a description the file is all there is.
    let model = world.path("other.onnx");
    fs::write(&model, network(0.04, 0.0, None)).unwrap();
    let hash = |out: &str, kernel: &str| {
        let description = format!(
            "input: {{width: {INPUT_WIDTH}, height: {INPUT_HEIGHT}, range: 0..1, kernel: {kernel}}}\n\
             output: {{meaning: disparity_fraction}}\n"
        );
        describe(&model, &description);
        world.bench("3.3", out, &["--model", &text(&model)]).code(0);
        world.rows(out)[0].context.model_hash.clone()
    };
    assert_ne!(hash("area", "area"), hash("bilinear", "bilinear"));
}

#[test]
fn what_an_interrupted_run_measured_with_another_description_is_measured_again() {
    let world = World::new(Split::Eigen, 3, false);
    let path = world.path("maps.npy");
    save(
        &path,
        SIZE,
        |_, _| CAMERA_M,
        "meaning: depth_m\nscale: 5.4\n",
    );
    evaluate(&world, "out", &path, &[]).code(0);
    // What a killed run leaves: its rows, and what they were measured with.
    let whole = fs::read(world.path("out/rows.csv")).unwrap();
    fs::write(world.path("out/unfinished-maps.csv"), &whole).unwrap();
    fs::write(world.path("out/unfinished-maps.yaml"), "scale: '5.4'\n").unwrap();
    describe(&path, "meaning: depth_m\nscale: 1.0\n");
    evaluate(&world, "out", &path, &[])
        .code(2)
        .says("other results of maps: scale was 5.4 and is 1.0");
    let ran = evaluate(&world, "out", &path, &["--force"]);
    ran.code(0).says("scale was 5.4 and is 1.0");
    assert!(!ran.err.contains("measured before"), "{}", ran.err);
    for row in under_camera_z(&world, "out") {
        assert!(row.score.metrics.abs_rel < 1e-6, "{:?}", row.score);
    }
}

#[test]
fn parts_of_different_descriptions_are_not_put_together() {
    let world = World::new(Split::Eigen, 3, false);
    let path = world.path("maps.npy");
    for (shard, description) in [
        ("0/2", "meaning: depth_m\n"),
        ("1/2", "meaning: depth_m\nscale: 2.0\n"),
    ] {
        save(&path, SIZE, |_, _| CAMERA_M, description);
        evaluate(&world, "parts", &path, &["--shard", shard]).code(0);
    }
    let merge = || {
        let mut command = Command::cargo_bin("bench").unwrap();
        run(command.arg("merge").arg(world.path("parts")))
    };
    merge()
        .code(1)
        .says("of model maps, scale was not there and is 2.0");
    save(&path, SIZE, |_, _| CAMERA_M, "meaning: depth_m\n");
    evaluate(&world, "parts", &path, &["--shard", "1/2", "--force"]).code(0);
    merge().code(0);
}

#[test]
fn maps_of_another_shape_are_refused_at_the_first_image() {
    let world = World::new(Split::Eigen, 3, false);
    let path = world.path("maps.npy");
    let (images, rows, columns) = SIZE;
    save(
        &path,
        (images, columns, rows),
        |_, _| CAMERA_M,
        "meaning: depth_m\n",
    );
    let ran = evaluate(&world, "transposed", &path, &[]);
    ran.code(1)
        .says("rows and columns seem to be swapped")
        .says("is refused at the first image");
    assert_eq!(ran.err.matches("swapped").count(), 1, "{}", ran.err);

    save(
        &path,
        (images, rows - 3, columns),
        |_, _| CAMERA_M,
        "meaning: depth_m\n",
    );
    evaluate(&world, "cropped", &path, &[])
        .code(1)
        .says("124x37 for an image of 124x40")
        .says("`stretched: true`");
    describe(&path, "meaning: depth_m\nstretched: true\n");
    evaluate(&world, "stretched", &path, &[]).code(0);

    // A network's own aspect is no mistake.
    save(
        &path,
        (images, 16, 32),
        |_, _| CAMERA_M,
        "meaning: depth_m\n",
    );
    evaluate(&world, "network", &path, &[]).code(0);
}

#[test]
fn values_that_cannot_be_are_refused_by_their_meaning() {
    let world = World::new(Split::Eigen, 3, false);
    let path = world.path("maps.npy");
    for (out, value, description, said) in [
        (
            "pixels",
            5.0,
            "meaning: disparity_fraction\n",
            "`meaning: disparity_px`",
        ),
        ("depth", 200.0, "meaning: disparity_px\n", "124 pixels"),
        (
            "negative",
            -0.5,
            "meaning: depth_m\n",
            "depth cannot be negative",
        ),
        (
            "sigmoid",
            1.2,
            "meaning: inverse_depth\nsigmoid: {min_depth: 0.1, max_depth: 100}\nscale: 5.4\n",
            "a sigmoid lies between 0 and 1",
        ),
    ] {
        // One value of the lower right corner is enough.
        let (_, rows, columns) = SIZE;
        let of = |row, column| {
            if (row, column) == (rows - 1, columns - 1) {
                value
            } else {
                0.5
            }
        };
        save(&path, SIZE, of, description);
        evaluate(&world, out, &path, &[])
            .code(1)
            .says(said)
            .says("row 39, column 123")
            .says("is refused at the first image");
    }
}

/// Every second column has no depth; the others are the truth.
#[test]
fn depth_of_zero_is_none_and_is_told() {
    let world = World::new(Split::Eigen, 3, false);
    let path = world.path("maps.npy");
    save(&path, SIZE, |_, _| CAMERA_M, "meaning: depth_m\n");
    evaluate(&world, "full", &path, &[]).code(0);
    let full = under_camera_z(&world, "full");
    let holes = |_: usize, column: usize| {
        if column.is_multiple_of(2) {
            CAMERA_M
        } else {
            0.0
        }
    };
    save(&path, SIZE, holes, "meaning: depth_m\n");
    let ran = evaluate(&world, "holes", &path, &[]);
    ran.code(0)
        .says("have no depth (0 is none) and are left out")
        .says("true/predicted median 1.0");
    for (full, holes) in full.iter().zip(under_camera_z(&world, "holes")) {
        assert!(holes.score.metrics.abs_rel < 1e-6, "{:?}", holes.score);
        assert_eq!(full.score.floored_pixels, 0);
        assert_eq!(
            holes.score.pixels + holes.score.floored_pixels,
            full.score.pixels
        );
        // The crop begins at an odd or even column, so half of the pixels to one column.
        let difference = holes.score.pixels.abs_diff(holes.score.floored_pixels);
        assert!(difference <= u64::from(HEIGHT), "{:?}", holes.score);
    }
    save(&path, SIZE, |_, _| 0.0, "meaning: depth_m\n");
    evaluate(&world, "dead", &path, &[])
        .code(1)
        .says("the map is dead");
}

#[test]
fn a_wrong_scale_shows_beside_the_truth() {
    let world = World::new(Split::Eigen, 3, false);
    let path = world.path("maps.npy");
    save(&path, SIZE, |_, _| CAMERA_M, "meaning: depth_m\nscale: 2\n");
    evaluate(&world, "out", &path, &[])
        .code(0)
        // The first protocol's truth is 10 m along the scanner's axis: 10 / 19.5.
        .says("true/predicted median 0.51 ± 0.00 over 3 images")
        .says("`scale`");
    let record = fs::read_to_string(world.path("out/run.yaml")).unwrap();
    assert!(record.contains("median_ratio: 0.51"), "{record}");
}

/// The test's camera has 72 / 124 of the width and 0.5 m; half the baseline is another one.
#[test]
fn a_model_of_another_camera_is_told() {
    let world = World::new(Split::Eigen, 3, false);
    let of = |name: &str, baseline_m: f64| {
        let mut metadata = metadata("eigen");
        metadata.camera = Some(TrainingCamera {
            focal_fraction: Spread::of([FOCAL_PX / f64::from(WIDTH)]).unwrap(),
            baseline_m: Spread::of([baseline_m]).unwrap(),
        });
        let path = world.path(&format!("{name}.onnx"));
        fs::write(&path, network(0.04, 0.0, Some(&metadata))).unwrap();
        world.bench("3.3", name, &["--model", &text(&path)])
    };
    let same = of("same", BASELINE_M);
    assert!(!same.code(0).err.contains("OTHER CAMERA"), "{}", same.err);
    of("other", BASELINE_M / 2.0)
        .code(0)
        .says("OTHER CAMERA: other, 3 images")
        .says("a baseline of 0.250 m, but this camera has 0.581 and 0.500 m");
}
