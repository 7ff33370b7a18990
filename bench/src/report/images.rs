//! The distribution over images, and the best and worst of them with their pictures.

use maud::{Markup, html};
use strat_metrics::{Row, rows::by_model};
use strat_store::{
    image_files,
    resize::{self, Kernel},
};

use super::{builder::Page, charts, collect::DataSet};
use crate::{
    draw::{comparison, sheet::data_address},
    evaluate::record::ModelRecord,
};

/// Best and worst images shown of each model.
const EXTREMES: usize = 3;
/// Width of a picture in pixels, its quality, and what all of them may weigh in bytes.
const PICTURE_WIDTH: u32 = 920;
const PICTURE_QUALITY: u8 = 74;
const PICTURES_BYTES: usize = 3_000_000;

impl Page {
    /// The distribution over images and its best and worst, under one protocol.
    pub(super) fn images(&mut self, index: usize, set: &DataSet, protocol: &str) -> Markup {
        let models = by_model(&set.rows, protocol);
        let curves = charts::of_images(&set.rows, protocol);
        let (Some(models), Some(curves)) = (self.or_problem(models), self.or_problem(curves))
        else {
            return html! {};
        };
        let mut parts = Vec::new();
        let mut absent = false;
        for (number, model) in models.iter().enumerate() {
            let mut rows: Vec<&Row> = model.rows().to_vec();
            rows.sort_by(|a, b| {
                let error = |row: &Row| row.score.metrics.abs_rel;
                error(a).total_cmp(&error(b)).then(a.image.cmp(&b.image))
            });
            let best = EXTREMES.min(rows.len() / 2);
            let (first, last) = (&rows[..best], &rows[rows.len() - best.max(1)..]);
            let name = &model.context().model;
            let chosen: Vec<(&str, &Row)> = last
                .iter()
                .rev()
                .map(|row| ("worst", *row))
                .chain(first.iter().map(|row| ("best", *row)))
                .collect();
            let mut shown = Vec::new();
            for (word, row) in &chosen {
                shown.extend(
                    self.picture(set, name, row)
                        .map(|address| (*word, *row, address)),
                );
            }
            absent |= shown.len() < chosen.len();
            parts.push(html! {
                h4 id={ "images-" (index) "-" (protocol) "-" (number) } { (name) }
                @if !shown.is_empty() {
                    div.charts {
                        @for (word, row, address) in &shown {
                            figure {
                                img src=(address) loading="lazy" decoding="async"
                                    alt={ "Image " (row.image) ", prediction, ground truth and error" };
                                figcaption { (of_image(word, row)) }
                            }
                        }
                    }
                }
                @if shown.len() < chosen.len() {
                    ul {
                        @for (word, row) in &chosen {
                            @if !shown.iter().any(|(_, with, _)| with.image == row.image) {
                                li { (of_image(word, row)) }
                            }
                        }
                    }
                }
            });
        }
        html! {
            p {
                "By Abs Rel under " (protocol) ". Pictures: input above, ground truth below, on the left; \
                 predicted depth above (bright is near, one scale for both) and relative depth error below (dark 0, \
                 bright " (comparison::WORST_ERROR) " and more), on the right; light grey was not scored."
            }
            @if absent {
                p.quiet {
                    "Pictures are shown where the run has made them: " code { "bench --extremes " (EXTREMES) } "."
                }
            }
            (self.charts(&[curves]))
            @for part in parts { (part) }
        }
    }

    /// The picture of an image as `data:` address, if one of the runs has made it and there is
    /// room for it.
    fn picture(&mut self, set: &DataSet, model: &str, row: &Row) -> Option<String> {
        let path = set.runs.iter().find_map(|run| {
            let own = run.record.as_ref()?.models.iter();
            let is_own = |record: &ModelRecord| {
                // Rows of earlier versions carry the file's digest alone.
                let known = [record.identity.digest(), record.blake3.clone()];
                record.name == model && known.contains(&row.context.model_hash)
            };
            own.clone()
                .any(is_own)
                .then(|| comparison::picture_of(&run.folder, row))
                .flatten()
        })?;
        let large = image_files::read_rgb(&path);
        let large = self.or_problem(large)?;
        let width = PICTURE_WIDTH.min(large.width());
        let height = (large.height() * width)
            .div_ceil(large.width().max(1))
            .max(1);
        let small = resize::rgb(&large, width, height, Kernel::Area);
        let encoded = data_address(
            "jpeg",
            &image_files::encode_jpeg_rgb(&small, PICTURE_QUALITY),
        );
        if self.picture_bytes + encoded.len() > PICTURES_BYTES {
            return None;
        }
        self.picture_bytes += encoded.len();
        Some(encoded)
    }
}

fn of_image(word: &str, row: &Row) -> Markup {
    html! {
        strong { (word) } " " code { (row.image) }
        (format!(
            ": Abs Rel {:.3}, RMSE {:.3} m, δ<1.25 {:.3} under {}",
            row.score.metrics.abs_rel,
            row.score.metrics.rmse,
            row.score.metrics.a1,
            row.context.protocol
        ))
    }
}
