//! The right views of one image at growing baselines (figure 3.4 of the thesis): what the discriminator is
//! shown from epoch to epoch, and how it differs from the view at the widest baseline.
//!
//! The disparity is that of the widest baseline throughout, so that for narrower ones the warp is only
//! nearly the view (PROTOCOL 4.3). What is torn and stretched grows with the baseline.

use strat_store::resize;

use super::{
    colour::magma,
    sheet::{Sheet, Tile, tile_size},
    side_by_side::{Synthesis, WORST_DIFFERENCE, difference, photograph, synthesize_right},
};

/// Width of a picture within the sheet.
const TILE_WIDTH: u32 = 300;
/// Views in a row.
const IN_A_ROW: usize = 5;
/// Fractions of the baseline, in tenths.
const TENTHS: std::ops::RangeInclusive<u8> = 1..=10;

/// The sheet of one model, as SVG.
#[must_use]
pub fn sheet(image: &str, model: &str, synthesis: &Synthesis) -> String {
    let (left, disparity) = (&synthesis.left, &synthesis.disparity);
    let size = tile_size(left.width(), left.height(), TILE_WIDTH);
    let widest = synthesize_right(left, disparity, 1.0);
    let mut rows = vec![vec![
        photograph(left, size, "left view".to_owned()),
        photograph(&synthesis.real, size, "real right view".to_owned()),
    ]];
    let tenths: Vec<u8> = TENTHS.collect();
    for tenths in tenths.chunks(IN_A_ROW) {
        let (mut views, mut differences) = (Vec::new(), Vec::new());
        for tenth in tenths {
            let b = f32::from(*tenth) / 10.0;
            let view = synthesize_right(left, disparity, b);
            let apart = difference(&view, &widest);
            let mean = apart.data.iter().sum::<f32>() / apart.data.len() as f32;
            let small = resize::area_f32(&apart, size.0 as usize, size.1 as usize);
            let picture = image::RgbImage::from_fn(size.0, size.1, |x, y| {
                magma(small.row(y as usize)[x as usize] / WORST_DIFFERENCE)
            });
            views.push(photograph(&view, size, format!("b = {b:.1}")));
            differences.push(Tile::drawn(&picture, format!("from b = 1: mean {mean:.1}")));
        }
        rows.extend([views, differences]);
    }
    Sheet {
        title: format!("Figure 3.4  Right views at growing baselines: {model}, {image}"),
        note: format!(
            "Synthesised from the left view at its own size. Below: difference to the widest in grey levels, \
             mean over the colours; black 0, bright {WORST_DIFFERENCE} and more."
        ),
        rows,
        ..Sheet::default()
    }
    .svg()
}

#[cfg(test)]
mod tests {
    use image::{Rgb, RgbImage};
    use strat_store::raster::Plane;

    use super::*;

    /// Stripes of one pixel under a disparity of two pixels: half of the baseline moves by one, which turns
    /// black into white; the whole baseline is no different from itself.
    #[test]
    fn differences_are_those_to_the_widest_baseline() {
        let left = RgbImage::from_fn(20, 8, |x, _| Rgb([if x % 2 == 0 { 0 } else { 255 }; 3]));
        let disparity = Plane::filled(20, 8, 0.1);
        let synthesis = Synthesis {
            right: synthesize_right(&left, &disparity, 1.0),
            real: left.clone(),
            left,
            disparity,
        };
        let svg = sheet("a/b", "strat <1>", &synthesis);
        assert!(
            svg.contains("strat &lt;1&gt;") && svg.contains("real right view"),
            "{svg}"
        );
        assert_eq!(svg.matches("<image").count(), 22);
        assert!(svg.contains("from b = 1: mean 0.0"));
        // 18 of 20 columns differ by 255; of the last two, outside of the image, one does.
        assert!(svg.contains("from b = 1: mean 242.2"), "{svg}");
    }
}
