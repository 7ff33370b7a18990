//! Files that are no models, damaged ones, and ones that harm a runtime.

use std::cell::Cell;
use std::path::{Path, PathBuf};

use proptest::prelude::*;
use proptest::test_runner::TestRunner;
use prost::Message;
use prost::bytes::Bytes;
use strat_onnx::embedded::EmbeddedSession;
use strat_onnx::graph::{Filter, Geometry, GraphBuilder};
use strat_onnx::metadata::{InputRange, ModelMetadata, OutputMeaning, Probe};
use strat_onnx::model::{self, ReadError};
use strat_onnx::proto::{ModelProto, NodeProto, StringStringEntryProto};

/// Convolution, transposed convolution and pool, with a full description.
fn small_model() -> Vec<u8> {
    let mut graph = GraphBuilder::new("small");
    let dims = ["N".into(), 1.into(), 4.into(), 4.into()];
    let input = graph.input("image", &dims).unwrap();
    let filter = |shape: [usize; 4]| Filter {
        shape,
        weights: vec![0.25; shape.iter().product()],
        bias: vec![0.5; 2],
    };
    let x = graph
        .conv("conv", input, filter([2, 1, 3, 3]), Geometry::new(1, 1))
        .unwrap();
    let x = graph.max_pool("pool", x, 2, Geometry::new(2, 0)).unwrap();
    let x = graph
        .conv_transpose("up", x, filter([2, 2, 4, 4]), Geometry::new(2, 1))
        .unwrap();
    graph.output("disparity", x).unwrap();
    let mut metadata = ModelMetadata::new(OutputMeaning::DisparityFraction, InputRange::Unit, 4, 4);
    metadata.seed = Some(7);
    metadata.split = Some("eigen".into());
    metadata.probe = Some(Probe::record(4, 4, &[0.125; 32]).unwrap());
    graph.finish(Some(&metadata)).unwrap()
}

fn edited(edit: impl FnOnce(&mut ModelProto)) -> Vec<u8> {
    let mut model = ModelProto::decode(Bytes::from(small_model())).unwrap();
    edit(&mut model);
    model.encode_to_vec()
}

fn set_attribute(model: &mut ModelProto, op: &str, name: &str, values: &[i64]) {
    let graph = model.graph.as_mut().unwrap();
    let node = graph
        .node
        .iter_mut()
        .find(|node| node.op_type.as_deref() == Some(op))
        .unwrap();
    let found = node
        .attribute
        .iter_mut()
        .find(|a| a.name.as_deref() == Some(name))
        .unwrap();
    if found.i.is_some() {
        found.i = Some(values[0]);
    } else {
        found.ints = values.to_vec();
    }
}

fn refusal(bytes: &[u8]) -> String {
    model::inspect(bytes, "m.onnx").unwrap_err().to_string()
}

#[test]
fn other_kinds_of_file_are_named() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("model.onnx");
    let message = |bytes: &[u8]| {
        std::fs::write(&path, bytes).unwrap();
        let text = model::read(&path).unwrap_err().to_string();
        assert!(text.contains("model.onnx"), "{text}");
        text
    };
    assert!(message(b"").contains("is empty"));
    let pointer = b"version https://git-lfs.github.com/spec/v1\noid sha256:00\nsize 5\n";
    assert!(message(pointer).contains("git lfs pull"));
    assert!(message(b"\n <!DOCTYPE html><title>404</title>").contains("web page"));
    assert!(message(b"PK\x03\x04....").contains("PyTorch"));
    assert!(message(&[0; 4096]).contains("zeros"));
    assert!(message(b"just some text").contains("not a complete ONNX model"));
    let cut = small_model();
    assert!(message(&cut[..cut.len() / 2]).contains("truncated"));

    assert!(matches!(
        model::read(folder.path()),
        Err(ReadError::Folder { .. })
    ));
    #[cfg(unix)]
    assert!(matches!(
        model::read("/dev/zero"),
        Err(ReadError::NotAFile { .. })
    ));
    let absent = model::read(folder.path().join("absent.onnx"));
    assert!(matches!(absent, Err(ReadError::Io { .. })));
}

#[test]
fn a_file_is_read_with_its_digest() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("model.onnx");
    let bytes = small_model();
    std::fs::write(&path, &bytes).unwrap();
    let file = model::read(&path).unwrap();
    assert_eq!(file.bytes, bytes.len() as u64);
    assert_eq!(file.blake3, blake3::hash(&bytes).to_hex().as_str());
    assert_eq!(
        file.info.metadata().unwrap().split.as_deref(),
        Some("eigen")
    );
    let session = EmbeddedSession::load(&path, Some(1)).unwrap();
    assert_eq!(session.inputs(), file.info.inputs);
    let found = session.run("image", &[1, 1, 4, 4], &[1.0; 16]).unwrap();
    assert_eq!(found[0].1, [1, 2, 4, 4]);
}

/// ONNX Runtime 1.31.1 dies of a division by zero on the first of these.
#[test]
fn divisors_below_one_are_refused() {
    for (op, name, values) in [
        ("ConvTranspose", "group", &[0][..]),
        ("Conv", "group", &[-1]),
        ("Conv", "strides", &[0, 1]),
        ("ConvTranspose", "dilations", &[1, 0]),
        ("MaxPool", "kernel_shape", &[0, 2]),
        ("MaxPool", "strides", &[2, -2]),
    ] {
        let bytes = edited(|model| set_attribute(model, op, name, values));
        let text = refusal(&bytes);
        assert!(text.contains(op) && text.contains(name), "{text}");
        assert!(EmbeddedSession::from_bytes(bytes, "m.onnx", Some(1)).is_err());
    }
    // The same inside a branch of an `If`.
    let bytes = edited(|model| {
        set_attribute(model, "Conv", "group", &[0]);
        let graph = model.graph.as_mut().unwrap();
        let inner = graph.clone();
        graph
            .node
            .retain(|node| node.op_type.as_deref() != Some("Conv"));
        graph.node[0].attribute[0].g = Some(inner);
    });
    assert!(refusal(&bytes).contains("group"));
}

#[test]
fn constants_must_have_the_length_of_their_shape() {
    for dims in [
        vec![2, 1, 3, 4],
        vec![-2, 1, 3, 3],
        vec![i64::MAX, 2, 2, 2],
        vec![i64::MAX],
    ] {
        let bytes = edited(|model| {
            model.graph.as_mut().unwrap().initializer[0].dims = dims;
        });
        assert!(refusal(&bytes).contains("conv.weight"));
    }
}

#[test]
fn incomplete_models_are_refused() {
    assert!(refusal(&edited(|model| model.graph = None)).contains("no graph"));
    assert!(refusal(&edited(|model| model.opset_import.clear())).contains("operator set"));
    assert!(refusal(&edited(|model| model.ir_version = None)).contains("version"));
    let bytes = edited(|model| model.graph.as_mut().unwrap().output.clear());
    assert!(refusal(&bytes).contains("no output"));
}

#[test]
fn unknown_operators_can_be_inspected_but_not_run() {
    let bytes = edited(|model| {
        let graph = model.graph.as_mut().unwrap();
        graph.node[1].op_type = Some("Teleport".into());
        graph.node[1].domain = Some("com.example".into());
    });
    let info = model::inspect(&bytes, "m.onnx").unwrap();
    assert_eq!(info.operators["com.example.Teleport"], 1);
    let error = EmbeddedSession::from_bytes(bytes, "m.onnx", Some(1))
        .err()
        .unwrap()
        .to_string();
    assert!(
        error.contains("m.onnx") && error.contains("Teleport"),
        "{error}"
    );
}

#[test]
fn a_cycle_is_an_error_of_the_runtime() {
    let bytes = edited(|model| {
        let node = |name: &str, input: &str, output: &str| NodeProto {
            name: Some(name.into()),
            op_type: Some("Relu".into()),
            input: vec![input.into()],
            output: vec![output.into()],
            ..NodeProto::default()
        };
        let graph = model.graph.as_mut().unwrap();
        graph.node = vec![node("a", "disparity", "b"), node("b", "b", "disparity")];
    });
    let run = EmbeddedSession::from_bytes(bytes, "m.onnx", Some(1))
        .and_then(|session| session.run("image", &[1, 1, 4, 4], &[1.0; 16]));
    assert!(run.is_err());
}

/// A model file whose first weights lie in `location`, with the given other entries.
fn external(folder: &Path, location: &str, more: &[(&str, &str)]) -> PathBuf {
    let bytes = edited(|model| {
        let tensor = &mut model.graph.as_mut().unwrap().initializer[0];
        tensor.raw_data = None;
        tensor.data_location = Some(1);
        tensor
            .external_data
            .push(StringStringEntryProto::new("location", location));
        for (key, value) in more {
            tensor
                .external_data
                .push(StringStringEntryProto::new(*key, *value));
        }
    });
    let path = folder.join("model.onnx");
    std::fs::write(&path, bytes).unwrap();
    path
}

#[test]
fn external_weights_stay_inside_the_folder() {
    let outer = tempfile::tempdir().unwrap();
    let folder = outer.path().join("models");
    std::fs::create_dir(&folder).unwrap();
    let weights: Vec<u8> = [0.25_f32; 18]
        .iter()
        .flat_map(|v| v.to_le_bytes())
        .collect();
    std::fs::write(outer.path().join("secret"), &weights).unwrap();
    std::fs::write(
        folder.join("weights.data"),
        [&[0; 4][..], &weights].concat(),
    )
    .unwrap();

    let path = external(
        &folder,
        "weights.data",
        &[("offset", "4"), ("length", "72")],
    );
    let file = model::read(&path).unwrap();
    assert_eq!(
        file.info.external_files.iter().collect::<Vec<_>>(),
        ["weights.data"]
    );
    let image = (0..16).map(|i| i as f32).collect::<Vec<_>>();
    let run = |session: EmbeddedSession| session.run("image", &[1, 1, 4, 4], &image).unwrap();
    let outside = run(EmbeddedSession::load(&path, Some(1)).unwrap());
    let inside = run(EmbeddedSession::from_bytes(small_model(), "m", Some(1)).unwrap());
    assert_eq!(outside, inside);

    // The digest covers the weights.
    std::fs::write(
        folder.join("weights.data"),
        [&[0; 4][..], &weights, &[1]].concat(),
    )
    .unwrap();
    assert_ne!(model::read(&path).unwrap().blake3, file.blake3);

    let text = |location: &str, more: &[(&str, &str)]| {
        let error = model::read(external(&folder, location, more)).unwrap_err();
        assert!(matches!(error, ReadError::ExternalData { .. }), "{error}");
        error.to_string()
    };
    let absolute = outer.path().join("secret").display().to_string();
    for location in [
        "../secret",
        "a/../../secret",
        "..\\secret",
        "C:secret",
        &absolute,
    ] {
        assert!(text(location, &[]).contains("inside the model's folder"));
    }
    assert!(text("", &[]).contains("names no file"));
    assert!(text("absent.data", &[]).contains("copy it beside the model"));
    assert!(text("weights.data", &[("offset", "8")]).contains("truncated"));
    assert!(text("weights.data", &[("offset", "18446744073709551615")]).contains("truncated"));
    assert!(text("weights.data", &[("length", "8")]).contains("8 bytes"));
    assert!(text("weights.data", &[("offset", "-1")]).contains("not a number"));
    #[cfg(unix)]
    {
        std::os::unix::fs::symlink(outer.path().join("secret"), folder.join("link.data")).unwrap();
        assert!(text("link.data", &[]).contains("leaves the model's folder"));
    }
    let bytes = std::fs::read(external(&folder, "weights.data", &[])).unwrap();
    assert!(refusal(&bytes).contains("needs a model file on disk"));
}

/// Wherever the file is cut, it is refused, or the description says that a part is missing.
#[test]
fn every_truncation_is_noticed() {
    let bytes = small_model();
    for length in 0..bytes.len() {
        if let Ok(info) = model::inspect(&bytes[..length], "m.onnx") {
            let noticed = info.properties.is_empty() || !info.description.problems.is_empty();
            assert!(noticed, "cut at {length} of {}", bytes.len());
        }
    }
}

proptest! {
    #![proptest_config(ProptestConfig { failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn random_bytes_never_panic(bytes in proptest::collection::vec(any::<u8>(), 0..400)) {
        let _ = model::inspect(&bytes, "m.onnx");
    }
}

/// What is accepted must also be safe to hand to the runtime; and enough must be accepted for that to
/// mean something.
#[test]
fn mutated_models_never_panic() {
    const CASES: u32 = 1000;
    let config = ProptestConfig {
        cases: CASES,
        failure_persistence: None,
        ..ProptestConfig::default()
    };
    let changes = proptest::collection::vec((any::<prop::sample::Index>(), any::<u8>()), 1..6);
    let removed = proptest::option::of((any::<prop::sample::Index>(), 1_usize..40));
    let count = |counter: &Cell<u32>| counter.set(counter.get() + 1);
    let (accepted, loaded, finished) = (Cell::new(0), Cell::new(0), Cell::new(0));
    let outcome = TestRunner::new(config).run(&(changes, removed), |(changes, removed)| {
        let mut bytes = small_model();
        for (index, value) in changes {
            let at = index.index(bytes.len());
            bytes[at] = value;
        }
        if let Some((index, length)) = removed {
            let at = index.index(bytes.len());
            bytes.drain(at..(at + length).min(bytes.len()));
        }
        if model::inspect(&bytes, "m.onnx").is_ok() {
            count(&accepted);
            if let Ok(session) = EmbeddedSession::from_bytes(bytes, "m.onnx", Some(1))
                && let Some(input) = session.inputs().first()
            {
                count(&loaded);
                let result = session.run(&input.name, &[1, 1, 4, 4], &[0.5; 16]);
                result.is_ok().then(|| count(&finished));
            }
        }
        Ok(())
    });
    outcome.unwrap();
    let found = [accepted.get(), loaded.get(), finished.get()];
    eprintln!("{CASES} mutants: {found:?} accepted, loaded, run to the end");
    assert!(
        found.iter().all(|count| *count > CASES / 20),
        "{CASES} mutants test next to nothing: {found:?} accepted, loaded, run to the end"
    );
}
