//! The run over all images: decode, predict, write.

use std::{ops::ControlFlow, path::PathBuf};

use strat_store::{
    command::error_chain, failures::Failures, image_files, progress::Progress, raster::Plane,
    signals::Watch,
};

use super::{
    jobs::ImageJob,
    write::{MapError, Writer},
};
use crate::{
    evaluate::pipeline::{self, MAX_INITIAL_FAILURES},
    model::{self, Model, ModelInput},
};

/// What came out.
#[derive(Debug, Default)]
pub struct Outcome {
    /// The files, in the order of the images.
    pub written: Vec<PathBuf>,
    /// Images without a result.
    pub failed: usize,
    /// Values that did not fit into 16 bits.
    pub too_large: usize,
    /// A signal ended the work.
    pub interrupted: bool,
}

/// Predicts and writes all images. Failures are named on stderr.
pub fn predict(
    jobs: &[ImageJob],
    model: &mut Model,
    pool: &rayon::ThreadPool,
    writer: &Writer<'_>,
    progress: &Progress,
) -> Outcome {
    let mut outcome = Outcome::default();
    let watch = Watch::new("stopping after this image");
    let input = model.description.input.clone();
    let mut tried = 0;
    let mut failures = Failures::default();
    let ended = pipeline::run(
        jobs,
        pipeline::chunk_size(pool),
        pool,
        |job| {
            let image = image_files::read_rgb(&job.image)?;
            let focal_px = writer.request.camera.map(|camera| camera.focal_px);
            Ok::<_, MapError>(model::prepare_input(&image, &input, focal_px)?)
        },
        |_, prepared| {
            if model.has_ended() {
                return ControlFlow::Break(());
            }
            let predict = |input: ModelInput| Ok((model.predict(&input)?, input.image));
            ControlFlow::Continue(prepared.and_then(predict))
        },
        |job, predicted: Result<(Plane, (u32, u32)), MapError>| {
            let (plane, size) = predicted?;
            writer.write(job, &plane, size)
        },
        |job, result| {
            tried += 1;
            progress.add(1);
            match result {
                Ok((paths, too_large)) => {
                    outcome.written.extend(paths);
                    outcome.too_large += too_large;
                }
                Err(error) => {
                    outcome.failed += 1;
                    let image = job.image.display().to_string();
                    if let Some(sentence) = failures.add(&image, &error_chain(&error)) {
                        progress.println(&format!("error: {sentence}"));
                    }
                }
            }
            if watch.told() {
                outcome.interrupted = true;
                return ControlFlow::Break(());
            }
            if outcome.failed >= MAX_INITIAL_FAILURES && outcome.written.is_empty() {
                return ControlFlow::Break(());
            }
            ControlFlow::Continue(())
        },
    );
    for sentence in failures.repeated() {
        progress.println(&format!("error: {sentence}"));
    }
    if ended.is_break() && tried < jobs.len() && !outcome.interrupted {
        progress.println(&match outcome.written.is_empty() {
            true => format!("error: the first {tried} images all failed, the rest was not tried"),
            false => format!(
                "error: the process of the model is over, {} images were not tried",
                jobs.len() - tried
            ),
        });
        outcome.failed += jobs.len() - tried;
    }
    outcome
}
