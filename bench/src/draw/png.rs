//! PNG of SVG by resvg, with a typeface that is linked in: no font of the system is needed and every
//! machine gives the same picture.

use std::sync::{Arc, LazyLock};

use resvg::{
    tiny_skia::{Pixmap, Transform},
    usvg::{Options, Tree, fontdb},
};
use strat_store::guard::guarded;

/// Why a picture cannot be made.
#[derive(Debug, thiserror::Error)]
#[error("the figure cannot be drawn: {0}")]
pub struct DrawError(String);

/// DejaVu Sans, regular and bold.
static FONTS: LazyLock<Arc<fontdb::Database>> = LazyLock::new(|| {
    let mut fonts = fontdb::Database::new();
    fonts.load_font_data(dejavu::sans::regular().to_vec());
    fonts.load_font_data(dejavu::sans::bold().to_vec());
    Arc::new(fonts)
});

/// Draws an SVG document as PNG, `zoom` times its size.
///
/// # Errors
/// The text is no SVG or its picture would be too large.
pub fn png(svg: &str, zoom: f32) -> Result<Vec<u8>, DrawError> {
    let pixels = pixels(svg, zoom)?;
    guarded("the PNG encoder", || pixels.encode_png())
        .map_err(DrawError)?
        .map_err(|error| DrawError(error.to_string()))
}

/// The same as pixels.
pub(super) fn pixels(svg: &str, zoom: f32) -> Result<Pixmap, DrawError> {
    guarded("the drawing library", || draw(svg, zoom)).map_err(DrawError)?
}

fn draw(svg: &str, zoom: f32) -> Result<Pixmap, DrawError> {
    let options = Options {
        font_family: "DejaVu Sans".to_owned(),
        fontdb: Arc::clone(&FONTS),
        ..Options::default()
    };
    let tree = Tree::from_str(svg, &options).map_err(|error| DrawError(error.to_string()))?;
    let size = tree.size();
    let side = |length: f32| (length * zoom).ceil() as u32;
    let mut pixmap = Pixmap::new(side(size.width()), side(size.height()))
        .ok_or_else(|| DrawError("its size is 0 or too large".to_owned()))?;
    resvg::render(
        &tree,
        Transform::from_scale(zoom, zoom),
        &mut pixmap.as_mut(),
    );
    Ok(pixmap)
}
