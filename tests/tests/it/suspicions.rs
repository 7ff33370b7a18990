//! What `bench` suspects after the first images, on saved predictions with a known answer: the truth of a
//! small set, distorted in one way each.

use std::ffi::OsString;
use std::path::Path;

use strat_store::{image_files, npy};
use strat_tests::steps::Command;

const WIDTH: usize = 64;
const HEIGHT: usize = 48;
const FOCAL_PX: f32 = 40.0;
const BASELINE_M: f32 = 0.5;
const IMAGES: usize = 5;

/// A road between a wall on the left and one on the right, farther away above: metres everywhere.
fn depth_m(image: usize, row: usize, column: usize) -> f32 {
    let (x, y) = (column as f32 / WIDTH as f32, row as f32 / HEIGHT as f32);
    4.0 + 50.0 * (1.0 - y) * (1.0 - y)
        + (9.0 + image as f32) * x
        + 3.0 * (7.0 * x + 5.0 * y).sin().abs()
}

/// The uppermost quarter is sky, where nothing is measured.
fn truth_m(image: usize, row: usize, column: usize) -> f32 {
    if row < HEIGHT / 4 {
        0.0
    } else {
        depth_m(image, row, column)
    }
}

fn write(path: &Path, bytes: &[u8]) {
    std::fs::create_dir_all(path.parent().expect("a folder")).expect("a folder");
    std::fs::write(path, bytes).expect("a file");
}

fn map(value: impl Fn(usize, usize) -> f32) -> Vec<u8> {
    let pixels = (0..WIDTH * HEIGHT).map(|i| value(i / WIDTH, i % WIDTH));
    npy::encode(WIDTH, HEIGHT, &pixels.collect::<Vec<f32>>())
}

fn run(command: Command, words: &[&str]) -> u8 {
    command.run(&words.iter().map(OsString::from).collect::<Vec<_>>())
}

/// Warnings of a run over maps of this description.
fn warnings(
    folder: &Path,
    name: &str,
    description: &str,
    value: impl Fn(usize, usize, usize) -> f32,
) -> String {
    let at = |name: &str| folder.join(name).to_str().expect("plain").to_owned();
    for image in 0..IMAGES {
        let path = folder.join(format!("{name}/rgb/{image}.npy"));
        write(&path, &map(|row, column| value(image, row, column)));
    }
    write(
        &folder.join(name).join("predictions.yaml"),
        description.as_bytes(),
    );
    let maps = format!("{name}={}", at(name));
    let out = at(&format!("out-{name}"));
    let words = [
        "--table",
        "all",
        "--data",
        &at("set"),
        "--predictions",
        &maps,
        "--protocol",
        "eigen-cameraz-80-nocrop",
        "--out",
        &out,
        "--quiet",
    ];
    assert_eq!(run(Command::Bench, &words), 0, "{name}");
    let record = std::fs::read_to_string(Path::new(&out).join("run.yaml")).expect("run.yaml");
    let (_, rest) = record.split_once("\nwarnings:").expect("warnings");
    let (own, _) = rest.split_once("\nfailures:").expect("failures");
    own.split_whitespace().collect::<Vec<_>>().join(" ")
}

#[test]
fn each_mistake_is_told_with_its_cause_and_the_line_to_change() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let folder = folder.path();
    let mut list = "left,depth,focal_px,baseline_m\n".to_owned();
    for image in 0..IMAGES {
        let grey = image::RgbImage::from_pixel(WIDTH as u32, HEIGHT as u32, image::Rgb([90; 3]));
        write(
            &folder.join(format!("rgb/{image}.png")),
            &image_files::encode_png_rgb(&grey),
        );
        let truth = map(|row, column| truth_m(image, row, column));
        write(&folder.join(format!("depth/{image}.npy")), &truth);
        list += &format!("rgb/{image}.png,depth/{image}.npy,{FOCAL_PX},{BASELINE_M}\n");
    }
    write(&folder.join("list.csv"), list.as_bytes());
    let at = |name: &str| folder.join(name).to_str().expect("plain").to_owned();
    let words = [
        "pairs",
        "--csv",
        &at("list.csv"),
        "--out",
        &at("set"),
        "--quiet",
    ];
    assert_eq!(run(Command::Prep, &words), 0);

    let metres = "meaning: depth_m\n";
    assert_eq!(warnings(folder, "right", metres, depth_m), "[]");
    let fraction =
        |image, row, column| FOCAL_PX * BASELINE_M / WIDTH as f32 / depth_m(image, row, column);
    assert_eq!(
        warnings(
            folder,
            "disparity",
            "meaning: disparity_fraction\n",
            fraction
        ),
        "[]"
    );

    let times = |factor: f32| move |image, row, column| factor * depth_m(image, row, column);
    let told = |name: &str,
                description: &str,
                value: &dyn Fn(usize, usize, usize) -> f32,
                words: &[&str]| {
        let said = warnings(folder, name, description, value);
        for word in words {
            assert!(said.contains(word), "{name}: no {word:?} in {said}");
        }
        assert_eq!(
            said.matches(&format!("{name}: ")).count(),
            1,
            "{name}: {said}"
        );
    };
    told(
        "millimetres",
        metres,
        &times(1000.0),
        &["millimetres", "`scale: 0.001`"],
    );
    told(
        "centimetres",
        metres,
        &times(100.0),
        &["centimetres", "`scale: 0.01`"],
    );
    told(
        "kitti",
        metres,
        &times(256.0),
        &["`png_divisor: 256`", "`scale: 0.00391`"],
    );
    told(
        "focal",
        metres,
        &times(1.0 / FOCAL_PX),
        &["focal length", "`scale: 40`"],
    );
    told(
        "pixels",
        "meaning: disparity_px\n",
        &fraction,
        &["width of the image", "`meaning: disparity_fraction`"],
    );
    told(
        "exchanged",
        metres,
        &|image, row, column| 60.0 / depth_m(image, row, column),
        &["near and far are exchanged", "`meaning: inverse_depth`"],
    );
    told(
        "unscaled",
        metres,
        &|image, row, column| 2.0_f32.powi(image as i32 - 2) * depth_m(image, row, column),
        &["another in each image", "`meaning: depth` without"],
    );
    told(
        "mirrored",
        metres,
        &|image, row, column| depth_m(image, row, WIDTH - 1 - column),
        &["left to right"],
    );
    told(
        "upside",
        metres,
        &|image, row, column| depth_m(image, HEIGHT - 1 - row, column),
        &["upside down"],
    );
    told(
        "transposed",
        metres,
        &|image, row, column| depth_m(image, column * HEIGHT / WIDTH, row * WIDTH / HEIGHT),
        &["rows and columns exchanged", "[rows, columns]"],
    );
    told(
        "sky",
        metres,
        &|image, row, column| {
            if row < HEIGHT / 4 {
                1.0
            } else {
                depth_m(image, row, column)
            }
        },
        &["a sky that is nearest"],
    );

    // What is only drawn is looked at as well.
    let drawn = |name: &str| {
        let (maps, out) = (at(name), at(&format!("figures-{name}")));
        let words = [
            "figures",
            "--data",
            &at("set"),
            "--predictions",
            &maps,
            "--protocol",
            "eigen-cameraz-80-nocrop",
            "--out",
            &out,
            "--quiet",
        ];
        assert_eq!(run(Command::Bench, &words), 0, "{name}");
        let record = Path::new(&out).join("figures.yaml");
        std::fs::read_to_string(record).expect("figures.yaml")
    };
    assert!(!drawn("right").contains("warnings:"));
    let said = drawn("millimetres");
    assert!(
        said.contains("warnings:") && said.contains("millimetres?"),
        "{said}"
    );
}
