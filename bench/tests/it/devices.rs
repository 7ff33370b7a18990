//! `bench devices` and `--device` from outside.

use crate::command::{bench, bench_with};

#[test]
fn every_device_has_a_verdict() {
    let ran = bench(&["devices", "--json"]);
    ran.code(0);
    let report: serde_json::Value = serde_json::from_str(&ran.out).unwrap();
    let devices = report["devices"].as_array().unwrap();
    assert_eq!(devices[0]["device"], "cpu");
    assert_eq!(devices[0]["available"], true);
    for device in devices {
        assert!(!device["detail"].as_str().unwrap().is_empty(), "{device}");
    }
    assert!(report["processor"]["threads"].as_u64().unwrap() >= 1);
    let text = bench(&["devices"]);
    for word in ["processor", "onnxruntime", "embedded", "cuda:0", "coreml"] {
        assert!(text.out.contains(word), "{}", text.out);
    }
}

#[test]
fn without_a_library_the_embedded_runtime_is_named() {
    let folder = tempfile::tempdir().unwrap();
    let nowhere = folder.path().join("libnothing.so");
    let environment = [("ORT_DYLIB_PATH", nowhere.to_str().unwrap())];
    let ran = bench_with(&["devices"], &environment);
    ran.code(0);
    assert!(ran.out.contains("not usable: "), "{}", ran.out);
    assert!(ran.out.contains("libnothing.so"), "{}", ran.out);
    assert!(
        ran.out.lines().any(|line| line.starts_with("cpu ")
            && line.contains("available")
            && line.contains("rten")),
        "{}",
        ran.out
    );
}

/// Asking for an accelerator ends on it or with a sentence, never on the processor.
#[test]
fn no_device_is_replaced_in_silence() {
    let folder = tempfile::tempdir().unwrap();
    let model = crate::fixtures::write_model(folder.path(), "m", 0.04, 0.0, "kitti");
    let (model, out) = (model.to_str().unwrap(), folder.path().join("out"));
    let image = folder.path().join("a.png");
    let picture = image::RgbImage::from_pixel(64, 32, image::Rgb([9, 9, 9]));
    std::fs::write(&image, strat_store::image_files::encode_png_rgb(&picture)).unwrap();
    let run = |device: &str, runtime: &str| {
        bench(&[
            "predict",
            image.to_str().unwrap(),
            "--model",
            model,
            "--out",
            out.to_str().unwrap(),
            "--format",
            "npy",
            "--device",
            device,
            "--runtime",
            runtime,
        ])
    };
    for device in ["cuda", "cuda:7", "tensorrt", "coreml", "directml"] {
        let ran = run(device, "auto");
        if ran.code == 0 {
            assert!(
                !ran.err.contains("nodes on CPUExecutionProvider\n"),
                "{}",
                ran.err
            );
            continue;
        }
        eprintln!("{device}: {}", ran.err);
        ran.code(1).says("error: ");
        assert!(!out.join("a.npy").exists(), "{device}");
        run(device, "embedded").code(1).says("runs on the CPU only");
    }
    run("gpu", "auto").code(2).says("known are cpu, cuda");
    run("cpu", "embedded").code(0);
}
