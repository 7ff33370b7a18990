//! Makes a leaderboard of many methods, to measure check and pages by:
//! `many_methods ROWS.csv FOLDER METHODS`, with measured rows and the `run.yaml` beside them.
//!
//! Each method has rows for all 697 images of the Eigen test: numbers of the measured rows in turn,
//! multiplied by a factor of the method and noise of the image. They are no measurements of anything.

use std::error::Error;
use std::fs;
use std::path::{Path, PathBuf};

use strat_leaderboard::publish::publish;
use strat_metrics::{Metrics, Row, rows};
use strat_splits::{Split, test_ids};
use strat_store::files;

fn main() -> Result<(), Box<dyn Error>> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [rows_file, folder, count] = &arguments[..] else {
        return Err("give ROWS.csv, a new folder and a number of methods".into());
    };
    let base = rows::read(fs::read(rows_file)?.as_slice())?;
    let first = base.first().ok_or("no rows")?.context.clone();
    let own = |row: &&Row| {
        row.context.protocol == first.protocol
            && row.context.model == first.model
            && row.score.group.is_none()
    };
    let base: Vec<&Row> = base.iter().filter(own).collect();
    let record = fs::read_to_string(PathBuf::from(rows_file).with_file_name("run.yaml"))?;
    let folder = Path::new(folder);
    let board = format!(
        "strat_leaderboard: 1\ntitle: Many methods\ndata:\n  - {{digest: {}, name: Made up, source: rendered, split: eigen, images: 697}}\n",
        first.data_digest
    );
    files::write_atomic(&folder.join("leaderboard.yaml"), board.as_bytes())?;
    let ids = test_ids(Split::Eigen);
    for number in 0..count.parse::<u32>()? {
        let name = format!("method-{number:04}");
        let made: Vec<Row> = ids
            .iter()
            .enumerate()
            .map(|(index, id)| row(base[index % base.len()], &name, number, id))
            .collect();
        let results = folder.join("results");
        let mut bytes = Vec::new();
        rows::write(&made, &mut bytes)?;
        files::write_atomic(&results.join("rows.csv"), &bytes)?;
        let renamed = record.replace(
            &format!("name: {}\n", first.model),
            &format!("name: {name}\n"),
        );
        let found = format!("test_images_found: {}", ids.len());
        let renamed: String = renamed
            .lines()
            .map(
                |line| match line.trim_start().starts_with("test_images_found:") {
                    true => format!("  {found}\n"),
                    false => format!("{line}\n"),
                },
            )
            .collect();
        files::write_atomic(&results.join("run.yaml"), renamed.as_bytes())?;
        let to = folder.join("submissions").join(&name);
        publish(&results.join("rows.csv"), Some(&name), &to)?;
        let card = fs::read_to_string(to.join("card.yaml"))?;
        let card = card
            .replace("supervision: \"fill in\"", "supervision: \"other\"")
            .replace("fill in", "nobody");
        files::write_atomic(&to.join("card.yaml"), card.as_bytes())?;
    }
    files::remove(&folder.join("results"))?;
    Ok(())
}

/// A row whose numbers still belong together.
fn row(base: &Row, name: &str, number: u32, image: &str) -> Row {
    let factor = 1.0 + 0.004 * f64::from(number) + 0.2 * noise(name, image);
    let mut row = base.clone();
    row.image = image.to_owned();
    row.context.model = name.to_owned();
    row.context.model_hash = files::blake3_hex(name.as_bytes());
    let score = &mut row.score;
    let pixels = score.pixels as f64;
    let share = |share: f64| (share.powf(factor) * pixels).round() / pixels;
    let old = score.metrics;
    score.metrics = Metrics {
        abs_rel: old.abs_rel * factor,
        sq_rel: old.sq_rel * factor,
        rmse: old.rmse * factor,
        rmse_log: old.rmse_log * factor,
        a1: share(old.a1),
        a2: share(old.a2),
        a3: share(old.a3),
    };
    score.sum_squared_error *= factor * factor;
    score.further = None;
    row
}

/// A number from -0.5 to 0.5 that depends on both texts.
fn noise(name: &str, image: &str) -> f64 {
    let digest = files::blake3_hex(format!("{name} {image}").as_bytes());
    let drawn = u32::from_str_radix(&digest[..8], 16).unwrap_or(0);
    f64::from(drawn) / f64::from(u32::MAX) - 0.5
}
