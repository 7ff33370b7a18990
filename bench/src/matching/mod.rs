//! Why photometric matching needs help (figure 3.2 of the thesis): what it costs to match a left pixel
//! along its line in the right image, where the truth lies, and how often the cheapest place is the true
//! one.
//!
//! [`cost`] has the costs of a line, [`survey`](mod@survey) goes over a test set, [`draw`] makes the
//! pictures. No model takes part.

pub mod cost;
pub mod draw;
pub mod survey;

use std::path::Path;

use strat_store::{
    files,
    set::{PreparedSet, Sample},
};

use self::survey::{Survey, View};
use crate::figures::{FigureError, write_sheets};

/// The table of how often the cheapest place is the true one.
pub const TABLE: &str = "matching.csv";

/// Where by texture pixels are chosen, as shares of all pixels with truth.
const SHARES: [f64; 4] = [0.05, 0.35, 0.65, 0.95];

/// What was drawn and found.
pub struct Matching {
    /// Names of the figures.
    pub written: Vec<String>,
    /// How often the cheapest place is the true one.
    pub survey: Survey,
}

/// Draws figure 3.2 of an image, for the given pixels of it (in its own size) or some of every
/// texture, and goes over all samples.
///
/// # Errors
/// The image has no right view or no ground truth, or a figure cannot be written.
pub fn write(
    out: &Path,
    set: &PreparedSet,
    samples: &[Sample],
    image: &Sample,
    pixels: &[(usize, usize)],
    pool: &rayon::ThreadPool,
    quiet: bool,
) -> Result<Matching, FigureError> {
    let Some(view) = View::open(set, image)?.filter(|view| !view.truths.is_empty()) else {
        return Err(FigureError::NoMatching {
            image: image.id.clone(),
        });
    };
    let mut chosen = Vec::new();
    for &(x, y) in pixels {
        chosen.push(draw::nearest(&view, (x, y)).ok_or_else(|| {
            let (width, height) = view.pair.size();
            FigureError::NoTruthAt {
                image: image.id.clone(),
                x,
                y,
                width,
                height,
            }
        })?);
    }
    if chosen.is_empty() {
        chosen = draw::by_texture(&view, &SHARES);
    }
    let mut written = write_sheets(out, "fig_3_2", &[draw::costs(&image.id, &view, &chosen)])?;
    let places = draw::places(&image.id, &view, &chosen);
    written.extend(write_sheets(out, "fig_3_2_places", &[places])?);
    let survey = survey::survey(set, samples, pool, quiet);
    for (cost, svg) in draw::found(&survey) {
        written.extend(write_sheets(out, &format!("fig_3_2_found_{cost}"), &[svg])?);
    }
    files::write_atomic(&out.join(TABLE), &survey.csv()?)?;
    Ok(Matching { written, survey })
}
