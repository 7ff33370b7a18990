//! Sets and rules of one's own, from a list of images to a row: `prep pairs` and a protocol in YAML as the
//! guides show them.

use std::ffi::OsString;
use std::path::{Path, PathBuf};

use strat_metrics::Row;
use strat_store::image_files;
use strat_tests::steps::Command;

const WIDTH: u32 = 640;
const HEIGHT: u32 = 480;

/// NYU Depth's Eigen crop, from the guide of `prep`.
fn protocol() -> String {
    let guide = std::fs::read_to_string(crate::sources::root().join("prep/README.md"))
        .expect("prep/README.md");
    let fence = guide
        .split("```yaml protocol\n")
        .nth(1)
        .expect("a protocol in the guide");
    fence.split("```").next().unwrap_or_default().to_owned()
}

fn write(path: &Path, bytes: &[u8]) {
    std::fs::create_dir_all(path.parent().expect("a folder")).expect("a folder");
    std::fs::write(path, bytes).expect("a file");
}

fn run(command: Command, words: &[&str]) -> u8 {
    command.run(&words.iter().map(OsString::from).collect::<Vec<_>>())
}

fn rows(folder: &Path) -> Vec<Row> {
    let file = std::fs::File::open(folder.join("rows.csv")).expect("rows.csv");
    strat_metrics::rows::read(file).expect("rows")
}

/// Two images without a right one and without a camera, metres that are a quarter too far in the crop and
/// nonsense outside of it.
#[test]
fn images_like_those_of_nyu_are_scored_in_their_crop() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let at = |name: &str| -> PathBuf { folder.path().join(name) };
    let text = |name: &str| at(name).to_str().expect("plain").to_owned();
    let is_inside = |i: u32| {
        let (row, column) = (i / WIDTH, i % WIDTH);
        (45..471).contains(&row) && (41..601).contains(&column)
    };
    let mut list = "left,depth,depth_scale\n".to_owned();
    for (name, millimetres) in [("a", 2000), ("b", 4000)] {
        let image = image::RgbImage::from_pixel(WIDTH, HEIGHT, image::Rgb([9, 8, 7]));
        write(
            &at(&format!("rgb/{name}.png")),
            &image_files::encode_png_rgb(&image),
        );
        let truth: Vec<u16> = vec![millimetres; (WIDTH * HEIGHT) as usize];
        let bytes = image_files::encode_png_gray16(WIDTH, HEIGHT, &truth);
        write(&at(&format!("depth/{name}.png")), &bytes);
        // 16-bit PNG of metres times 256.
        let predicted =
            |i| (if is_inside(i) { 1.25 } else { 3.0 } * f64::from(millimetres) * 0.256) as u16;
        let predicted: Vec<u16> = (0..WIDTH * HEIGHT).map(predicted).collect();
        let bytes = image_files::encode_png_gray16(WIDTH, HEIGHT, &predicted);
        write(&at(&format!("maps/rgb/{name}.png")), &bytes);
        list += &format!("rgb/{name}.png,depth/{name}.png,1000\n");
    }
    write(&at("nyu.csv"), list.as_bytes());
    write(&at("nyu.yaml"), protocol().as_bytes());
    write(&at("maps/predictions.yaml"), b"meaning: depth_m\n");
    let prepared = run(
        Command::Prep,
        &[
            "pairs",
            "--csv",
            &text("nyu.csv"),
            "--out",
            &text("set"),
            "--quiet",
        ],
    );
    assert_eq!(prepared, 0);
    let maps = format!("ours={}", text("maps"));
    let measured = |maps: &str, out: &str| {
        let words = [
            "--table",
            "all",
            "--data",
            &text("set"),
            "--predictions",
            maps,
            "--protocol",
            &text("nyu.yaml"),
            "--out",
            &text(out),
            "--quiet",
        ];
        run(Command::Bench, &words)
    };
    assert_eq!(measured(&maps, "results"), 0);
    let rows = rows(&at("results"));
    assert_eq!(rows.len(), 2);
    for row in &rows {
        assert_eq!(row.score.pixels, 426 * 560);
        let abs_rel = row.score.metrics.abs_rel;
        assert!((abs_rel - 0.25).abs() < 1e-3, "{abs_rel}");
    }

    // Disparity has no metres without a camera: refused by name, image by image.
    write(
        &at("maps/predictions.yaml"),
        b"meaning: disparity_px\npng_divisor: 256\n",
    );
    assert_eq!(measured(&maps, "refused"), 1);
    let failures = std::fs::read_to_string(at("refused/failures.csv")).expect("failures.csv");
    assert!(failures.contains("nyu-eigen has no camera"), "{failures}");
}
