//! Models without a scale against the independent implementation, from KITTI's files to rows.
//!
//! `tests/oracle/aligned.py` writes maps that are exact but for a known scale and shift, with the whole
//! image, KITTI's benchmark crop, depth, inverse depth and metres; `prep` and `bench` read them as a user
//! would; a network that sees the crop alone runs as any model does. The depth of a scan along the camera's axis stands for improved ground truth, of which no real
//! test frame is needed so. `STRAT_KITTI_SAMPLES` adds real frames.

use std::collections::{BTreeMap, BTreeSet};
use std::ffi::{OsStr, OsString};
use std::path::Path;

use strat_metrics::{Row, rows};
use strat_needs::Need;
use strat_onnx::graph::{Filter, Geometry, GraphBuilder};
use strat_splits::Role;
use strat_store::set::PreparedSet;
use strat_tests::steps::Command;

use crate::python::oracle;

fn words(words: &[&dyn AsRef<OsStr>]) -> Vec<OsString> {
    words.iter().map(|word| word.as_ref().to_owned()).collect()
}

/// By kind of model, protocol and image: seven metrics, five further ones, scale and shift.
type Expected = BTreeMap<(String, String, String), Vec<Option<f64>>>;

fn found(row: &Row) -> Vec<Option<f64>> {
    let further = row.score.further.expect("asked for").to_array();
    let mut values: Vec<Option<f64>> = row.score.metrics.to_array().map(Some).into();
    values.extend(further.map(Some));
    values.extend([
        row.score.fit.map(|fit| fit.scale),
        row.score.fit.map(|fit| fit.shift),
    ]);
    values
}

/// A network for KITTI's benchmark crop at its own size: metres that grow with red, as `RED_M` of the oracle
/// says.
fn write_network(path: &Path) {
    let mut graph = GraphBuilder::new("test");
    let dims = [1.into(), 3.into(), 352.into(), 1216.into()];
    let image = graph.input("image", &dims).expect("an input");
    let filter = Filter {
        shape: [1, 3, 1, 1],
        weights: vec![60.0, 0.0, 0.0],
        bias: vec![2.0],
    };
    let depth = graph.conv("red", image, filter, Geometry::new(1, 0));
    graph
        .output("depth", depth.expect("a convolution"))
        .expect("an output");
    std::fs::write(path, graph.finish(None).expect("a network")).expect("a file");
    let description =
        "input: {range: 0..1, width: 1216, height: 352}\noutput: {meaning: depth_m}\n";
    std::fs::write(path.with_extension("yaml"), description).expect("a description");
}

fn agrees(data: &Path) {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let at = |name: &str| folder.path().join(name);
    if oracle("aligned.py", &[data, folder.path()]).is_none() {
        return;
    }
    let mut line = words(&[
        &"eigen",
        &"--raw",
        &data.join("kitti_raw"),
        &"--out",
        &at("set"),
    ]);
    line.extend(words(&[
        &"--annotated",
        &at("annotated"),
        &"--allow-missing",
    ]));
    line.extend(words(&[&"--test-only", &"--quiet"]));
    assert_eq!(Command::Prep.run(&line), 0);
    let samples = PreparedSet::open(&at("set")).and_then(|set| set.samples(Role::Test));
    let images: BTreeSet<String> = samples
        .expect("samples")
        .into_iter()
        .map(|s| s.id)
        .collect();
    assert!(images.len() >= 2, "{images:?}");

    let text = std::fs::read_to_string(at("expected.json")).expect("what the oracle wrote");
    let records: Vec<(String, String, String, Vec<Option<f64>>)> =
        serde_json::from_str(&text).expect("JSON");
    let mut expected: Expected = records
        .into_iter()
        .filter(|(_, _, image, _)| images.contains(image))
        .map(|(kind, protocol, image, values)| ((kind, protocol, image), values))
        .collect();
    let kinds: BTreeSet<String> = expected.keys().map(|(kind, ..)| kind.clone()).collect();
    for kind in kinds {
        let out = at(&format!("out-{kind}"));
        let is_network = kind == "network";
        let (how, file) = match is_network {
            true => ("--model", at("network.onnx")),
            false => ("--predictions", at(&kind)),
        };
        if is_network {
            write_network(&file);
        }
        let given = format!("{kind}={}", file.display());
        let mut line = words(&[
            &"--table",
            &"eigen-652",
            &"--data",
            &at("set"),
            &"--out",
            &out,
        ]);
        line.extend(words(&[
            &how,
            &given,
            &"--runtime",
            &"embedded",
            &"--quiet",
        ]));
        let own = expected.keys().filter(|(other, ..)| *other == kind);
        let protocols: BTreeSet<&String> = own.map(|(_, protocol, _)| protocol).collect();
        for protocol in protocols {
            line.extend(words(&[&"--protocol", protocol]));
        }
        assert_eq!(Command::Bench.run(&line), 0, "{kind}");
        let file = std::fs::File::open(out.join("rows.csv")).expect("rows");
        for row in rows::read(file).expect("rows") {
            let key = (
                kind.clone(),
                row.context.protocol.clone(),
                row.image.clone(),
            );
            // What is shown the whole image as well is resized there, which is not what is tested here.
            if is_network && key.1.starts_with("eigen-improved") {
                continue;
            }
            let values = expected
                .remove(&key)
                .unwrap_or_else(|| panic!("{key:?}: no such row"));
            let pairs = found(&row).into_iter().zip(values);
            for (index, (found, expected)) in pairs.enumerate() {
                let (Some(found), Some(expected)) = (found, expected) else {
                    assert_eq!(found, expected, "{key:?} {index}");
                    continue;
                };
                // Shares of pixels may differ by a pixel on the threshold; what is exact but for
                // single precision has no digits to compare; inverse depth scaled by medians becomes
                // disparity and depth in single precision first.
                let relative = if key.1.ends_with("-median") {
                    5e-6
                } else {
                    1e-6
                };
                let allowed = match index {
                    4..=6 => 1.5 / row.score.pixels as f64,
                    _ if expected.abs() < 1e-3 => 1e-5,
                    _ => relative * expected.abs(),
                };
                assert!(
                    (found - expected).abs() <= allowed,
                    "{key:?} {index}: {found}, {expected}"
                );
            }
            // The right alignment of an exact map leaves nothing.
            if key.1.contains("affine") && kind != "metric" && !is_network {
                assert!(row.score.metrics.abs_rel < 1e-5, "{key:?}");
            }
        }
        let table = std::fs::read_to_string(out.join("table_eigen_652.txt")).expect("a table");
        assert!(table.contains("saw the ground truth"), "{table}");
    }
    assert!(
        expected.is_empty(),
        "bench has no row for {:?}",
        expected.keys()
    );
}

#[test]
fn aligned_rows_are_those_of_the_oracle() {
    let data = tempfile::tempdir().expect("a temporary folder");
    agrees(data.path());
}

#[test]
fn aligned_rows_of_real_frames_are_those_of_the_oracle() {
    let Some(samples) = std::env::var_os("STRAT_KITTI_SAMPLES") else {
        Need::KittiFrames.is_lacking("STRAT_KITTI_SAMPLES names no frames");
        return;
    };
    agrees(samples.as_ref());
}
