//! Writes the embedded sprites (`bench/sprites/*.png`) anew; see `draw.rs` for what they are.

mod draw;

use std::path::Path;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("sprites");
    for drawing in draw::DRAWINGS {
        let image = image::RgbaImage::from_raw(drawing.width, drawing.height, drawing.pixels())
            .ok_or("the pixels do not fill the sprite")?;
        image.save(folder.join(drawing.file))?;
        eprintln!("{}", drawing.file);
    }
    Ok(())
}
