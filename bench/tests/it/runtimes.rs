//! Both runtimes on the same small networks. ONNX Runtime is installed when it is missing; where
//! that is impossible the comparisons say so.

use std::path::{Path, PathBuf};

use strat_bench::runtime::{Device, Runtime, RuntimeChoice};
use strat_onnx::graph::{Filter, Geometry, GraphBuilder};

use crate::fixtures::onnxruntime;

/// A network with every kind of layer the generator has, deterministic weights.
fn write_network(folder: &Path) -> PathBuf {
    let weights = |count: usize| -> Vec<f32> {
        (0..count)
            .map(|i| ((i * 37 % 101) as f32 - 50.0) / 400.0)
            .collect()
    };
    let filter = |shape: [usize; 4], outputs: usize| Filter {
        shape,
        weights: weights(shape.iter().product()),
        bias: weights(outputs),
    };
    let mut graph = GraphBuilder::new("layers");
    let image = graph
        .input("image", &["N".into(), 3.into(), 32.into(), 64.into()])
        .unwrap();
    let a = graph
        .conv("a", image, filter([8, 3, 7, 7], 8), Geometry::new(2, 3))
        .unwrap();
    let a = graph.elu("a_elu", a).unwrap();
    let b = graph
        .conv("b", a, filter([8, 8, 3, 3], 8), Geometry::new(2, 1))
        .unwrap();
    let b = graph.elu("b_elu", b).unwrap();
    let b = graph
        .conv_transpose("up", b, filter([8, 8, 4, 4], 8), Geometry::new(2, 1))
        .unwrap();
    let c = graph.concat("cat", &[a, b], 1).unwrap();
    let c = graph.nearest_x2("up2", c).unwrap();
    let d = graph
        .conv("d", c, filter([2, 16, 3, 3], 2), Geometry::new(1, 1))
        .unwrap();
    let d = graph.sigmoid("s", d).unwrap();
    let d = graph.scale("disp", d, 0.3).unwrap();
    graph.output("disparity", d).unwrap();
    let path = folder.join("layers.onnx");
    std::fs::write(&path, graph.finish(None).unwrap()).unwrap();
    path
}

#[test]
fn both_runtimes_agree() {
    let Some(library) = onnxruntime() else { return };
    let folder = tempfile::tempdir().unwrap();
    let path = write_network(folder.path());
    let image = strat_onnx::metadata::probe_image(64, 32);
    let mut results = Vec::new();
    for choice in [
        RuntimeChoice::Ort,
        RuntimeChoice::Embedded,
        RuntimeChoice::Auto,
    ] {
        let (runtime, notice) = Runtime::resolve(choice, Device::Cpu).unwrap();
        assert_eq!(notice, None, "with a library at {}", library.display());
        let mut session = runtime.load(&path, Device::Cpu, 2).unwrap();
        eprintln!(
            "{choice:?}: {} on {}",
            session.runtime(),
            session.provider()
        );
        let outputs = session
            .run("image", [1, 3, 32, 64], &image, "disparity")
            .unwrap();
        assert_eq!(outputs.len(), 1);
        assert_eq!(outputs[0].name, "disparity");
        assert_eq!(outputs[0].shape, [1, 2, 32, 64]);
        results.push(outputs[0].data.clone());
    }
    assert_eq!(results[0], results[2], "auto means ONNX Runtime here");
    let largest = results[0]
        .iter()
        .zip(&results[1])
        .map(|(a, b)| (a - b).abs())
        .fold(0.0, f32::max);
    // 0.3 full scale; both are single precision with different orders of summation.
    assert!(largest < 1e-6, "largest difference {largest}");
    assert!(largest > 0.0 || results[0] == results[1]);
    let spread = results[0].iter().copied().fold(0.0, f32::max)
        - results[0].iter().copied().fold(1.0, f32::min);
    assert!(spread > 0.01, "the network must not be constant");
}

#[test]
fn a_wrong_input_is_a_sentence_in_both() {
    let folder = tempfile::tempdir().unwrap();
    let path = write_network(folder.path());
    let mut choices = vec![RuntimeChoice::Embedded];
    choices.extend(onnxruntime().map(|_| RuntimeChoice::Ort));
    for choice in choices {
        let (runtime, _) = Runtime::resolve(choice, Device::Cpu).unwrap();
        let mut session = runtime.load(&path, Device::Cpu, 1).unwrap();
        let error = session.run(
            "image",
            [1, 3, 16, 64],
            &vec![0.0; 3 * 16 * 64],
            "disparity",
        );
        let text = error.unwrap_err().to_string();
        assert!(text.contains("image"), "{choice:?}: {text}");
        assert!(!text.contains(".cc:"), "{choice:?}: {text}");
        let text = session
            .run(
                "picture",
                [1, 3, 32, 64],
                &vec![0.0; 3 * 32 * 64],
                "disparity",
            )
            .unwrap_err()
            .to_string();
        eprintln!("{choice:?}: {text}");
        assert!(text.contains("picture"), "{choice:?}: {text}");
    }
}

#[test]
fn cuda_is_never_replaced_by_the_cpu() {
    // On a machine with a suitable driver and the GPU build this resolves; anywhere else it must
    // say what is missing.
    match Runtime::resolve(RuntimeChoice::Auto, Device::Cuda(0)) {
        Ok((runtime, notice)) => {
            assert!(runtime.library().is_some());
            assert_eq!(notice, None);
        }
        Err(error) => {
            let text = error.to_string();
            eprintln!("{text}");
            assert!(
                ["driver", "device", "CUDA"]
                    .iter()
                    .any(|w| text.contains(w)),
                "{text}"
            );
        }
    }
}
