//! Operator forms in the ONNX Runtime that is found here: what `forms.json` was made with, and what the
//! embedded runtime is held to, is what this one computes.

use strat_bench::runtime::{Device, Runtime, RuntimeChoice};

use crate::fixtures::onnxruntime;

#[path = "../../../train/onnx/tests/forms/mod.rs"]
mod file;

#[test]
fn onnx_runtime_computes_the_forms_as_recorded() {
    if onnxruntime().is_none() {
        return;
    }
    let (runtime, _) = Runtime::resolve(RuntimeChoice::Ort, Device::Cpu).unwrap();
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("form.onnx");
    let mut wrong = Vec::new();
    let forms = file::read(include_str!("../../../train/onnx/tests/forms/forms.json"));
    let mut count = 0;
    for form in forms.iter().filter(|form| form.runs) {
        // Models have images as their inputs here.
        let Ok(shape) = <[usize; 4]>::try_from(form.x.as_slice()) else {
            continue;
        };
        count += 1;
        std::fs::write(&path, form.model(*form.opsets.last().unwrap())).unwrap();
        let session = runtime.load(&path, Device::Cpu, 1);
        let outputs =
            session.and_then(|mut session| session.run("x", shape, &file::values(&form.x, 0), "y"));
        match outputs {
            Err(error) => wrong.push(format!("{}: {error}", form.name)),
            Ok(outputs) if outputs[0].shape != form.shape => {
                wrong.push(format!("{}: {:?}", form.name, outputs[0].shape));
            }
            Ok(outputs) => {
                let difference = file::difference(&outputs[0].data, &form.y());
                if difference > 1e-5 {
                    wrong.push(format!("{}: differs by {difference:e}", form.name));
                }
            }
        }
    }
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
    assert!(count > 400, "{count} forms");
}
