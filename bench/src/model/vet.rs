//! What is asked of every model before anything is measured or drawn with it: the trainer's own
//! probe, whether it was trained on what it is tested on, and with which camera.
//!
//! Every subcommand that runs a model passes here; each decides only whether what is found is a
//! warning or a refusal.

use strat_onnx::metadata::OutputMeaning;

use super::{
    Model, ModelError, PROBE_TOLERANCE, ProbeResult, description_path,
    leakage::{self, Leakage, Tested},
};

/// What is known about a model before it is used.
#[derive(Clone, Debug, PartialEq)]
pub struct Vetting {
    /// The difference to the trainer's own output; none from a model without a probe.
    pub probe: Option<ProbeResult>,
    /// What of the test the model has seen in its training; `None` where nothing is tested.
    pub leakage: Option<Leakage>,
    /// Why its figures cannot be trusted or compared: sentences that name the model.
    pub warnings: Vec<String>,
    /// What was checked, and what could not be.
    pub notes: Vec<String>,
}

impl Vetting {
    /// The runtime is known to compute something else than what was trained.
    #[must_use]
    pub fn probe_failed(&self) -> bool {
        self.probe.is_some_and(|result| !result.passes())
    }
}

/// Asks a model its probe and looks for its training among the images it is `tested` on.
///
/// # Errors
/// The model does not run, or its probe does not fit it.
pub fn vet(model: &mut Model, tested: Option<Tested<'_>>) -> Result<Vetting, ModelError> {
    let name = model.name.clone();
    let problems = &model.file.info.description.problems;
    let mut vetting = Vetting {
        probe: None,
        leakage: None,
        warnings: problems
            .iter()
            .map(|problem| format!("model {name}: {problem}"))
            .collect(),
        notes: Vec::new(),
    };
    if let Some(doubt) = model.description.input.doubt() {
        vetting.warnings.push(format!("model {name}: {doubt}"));
    }
    if model.unconfirmed > 0 {
        vetting.warnings.push(format!(
            "model {name}: {} lines of its description ({}) are still to be confirmed, so its numbers \
             are provisional",
            model.unconfirmed,
            description_path(&model.file.path).display()
        ));
    }
    if let Some(tested) = tested {
        let metadata = model.file.info.metadata();
        let leakage = leakage::check(metadata, &tested);
        let (samples, content) = (tested.samples, tested.content);
        match &leakage {
            Leakage::None => {
                if let Some(trained) = tested.other_world(metadata) {
                    vetting.notes.push(format!(
                        "model {name} was trained on {trained} images and is tested on {} ones, which show \
                         other places even where their drives have the same names",
                        tested.source
                    ));
                }
            }
            Leakage::Drives { drives, images } => vetting.warnings.push(format!(
                "LEAKAGE: model {name} was trained on drives that {images} of the {} test images \
                 come from ({}); its numbers say nothing about new places and must not be compared",
                samples.len(),
                drives.join(", ")
            )),
            Leakage::OtherSplit { trained } => vetting.warnings.push(format!(
                "LEAKAGE: model {name} was trained on the {trained} split and is tested on the \
                 {content} split; drives of its training may be among the test images, so its \
                 numbers say nothing about new places and must not be compared"
            )),
            Leakage::Unknown => vetting.notes.push(format!(
                "model {name} does not say all that it was trained on, so leakage cannot be checked"
            )),
        }
        vetting.leakage = Some(leakage);
        let cameras = samples.iter().map(|sample| {
            let focal_fraction = sample.focal_px / f64::from(sample.width);
            (focal_fraction, sample.baseline_m)
        });
        vetting.warnings.extend(other_camera(model, cameras));
    }
    vetting.probe = model.probe()?;
    match vetting.probe {
        None => vetting.notes.push(format!(
            "model {name} has no self-test (normal for third-party models), so whether this runtime \
             computes what was trained is not checked"
        )),
        Some(result) if result.passes() => vetting.notes.push(format!(
            "model {name} on {}: largest difference to the trainer's own output {:.1e}",
            model.provider(),
            result.max_difference
        )),
        Some(result) => vetting.warnings.push(format!(
            "PROBE FAILED: model {name} on {} differs from the trainer's own output by {:.1e} (more \
             than {PROBE_TOLERANCE:.0e}); this runtime does not compute what was trained, so trust \
             neither numbers nor maps",
            model.provider(),
            result.max_difference
        )),
    }
    Ok(vetting)
}

/// Says so where a model of disparity was trained with another camera than that of images it is to
/// see: their focal lengths, as fractions of their widths, and baselines. Cameras that are not known
/// (0) are left out.
pub fn other_camera(
    model: &Model,
    cameras: impl IntoIterator<Item = (f64, f64)>,
) -> Option<String> {
    let meaning = model.description.output.meaning();
    let is_disparity = matches!(
        meaning,
        OutputMeaning::DisparityFraction | OutputMeaning::DisparityPx
    );
    let trained = model.file.info.metadata().and_then(|m| m.camera);
    let trained = trained.filter(|_| is_disparity)?;
    let (mut images, mut first) = (0, None);
    for (focal_fraction, baseline_m) in cameras {
        if focal_fraction > 0.0 && baseline_m > 0.0 {
            let difference = trained.difference(focal_fraction, baseline_m);
            images += usize::from(difference.is_some());
            first = first.or(difference);
        }
    }
    first.map(|difference| {
        format!(
            "OTHER CAMERA: {}, {images} images: {difference}",
            model.name
        )
    })
}
