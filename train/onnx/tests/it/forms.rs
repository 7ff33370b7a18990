//! Operator forms one by one: computed as ONNX Runtime does, or refused with a sentence.
//!
//! Recipe: train/onnx/tests/forms/make.py, with ONNX Runtime 1.31.1.

use strat_onnx::embedded::EmbeddedSession;

#[path = "../forms/mod.rs"]
mod file;

use file::{Form, values};

const FORMS: &str = include_str!("../forms/forms.json");

/// Shape and elements of the output `y`, or the sentence.
fn run(form: &Form, opset: i64) -> Result<(Vec<usize>, Vec<f32>), String> {
    let session = EmbeddedSession::from_bytes(form.model(opset), &form.name, Some(1));
    let session = session.map_err(|error| error.to_string())?;
    let outputs = session.run("x", &form.x, &values(&form.x, 0));
    let outputs = outputs.map_err(|error| error.to_string())?;
    let (_, shape, y) = outputs.into_iter().next().expect("one output");
    Ok((shape, y))
}

#[test]
fn listed_forms_are_computed_as_onnx_runtime_does() {
    let mut wrong = Vec::new();
    let mut count = 0;
    for form in file::read(FORMS).iter().filter(|form| form.runs) {
        for &opset in &form.opsets {
            count += 1;
            let name = format!("{}, opset {opset}", form.name);
            match run(form, opset) {
                Err(sentence) => wrong.push(format!("{name}: {sentence}")),
                Ok((shape, _)) if shape != form.shape => {
                    wrong.push(format!("{name}: {shape:?} instead of {:?}", form.shape));
                }
                Ok((_, y)) => {
                    let difference = file::difference(&y, &form.y());
                    if difference > 2e-6 {
                        wrong.push(format!("{name}: differs by {difference:e}"));
                    }
                }
            }
        }
    }
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
    assert!(count > 900, "{count} forms");
}

#[test]
fn all_other_forms_are_refused_with_the_remedy() {
    let mut wrong = Vec::new();
    let mut count = 0;
    for form in file::read(FORMS).iter().filter(|form| !form.runs) {
        for &opset in &form.opsets {
            count += 1;
            match run(form, opset) {
                Err(sentence) if sentence.contains("`bench setup`") => {}
                Err(sentence) => wrong.push(format!("{}: no remedy: {sentence}", form.name)),
                Ok((_, y)) => wrong.push(format!("{}, opset {opset}: {y:?}", form.name)),
            }
        }
    }
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
    assert!(count > 200, "{count} forms");
}
