//! A line of `latency.csv`, the file in both directions, and a table for a terminal.

use std::{
    fmt,
    io::{self, Read, Write},
};

use serde::{Deserialize, Serialize};

/// Version of the columns of `latency.csv`; stands in every row.
pub const FORMAT: u32 = 1;

/// How every file of rows begins.
pub const HEADER: &str = "format,model,model_hash,";

/// What is timed.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Stage {
    /// The session alone.
    Session,
    /// From a file to depth in metres.
    FileToDepth,
    /// From a file to disparity in pixels, where no camera is known.
    FileToDisparity,
    /// From a file to inverse depth of unknown scale.
    FileToInverseDepth,
}

impl fmt::Display for Stage {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Session => "session",
            Self::FileToDepth => "file_to_depth",
            Self::FileToDisparity => "file_to_disparity",
            Self::FileToInverseDepth => "file_to_inverse_depth",
        })
    }
}

/// How queries are sent.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Scenario {
    /// One image per query, one query after the other.
    SingleStream,
    /// One batch per query, one query after the other.
    MultiStream,
    /// All images at hand; only throughput is measured.
    Offline,
}

impl fmt::Display for Scenario {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::SingleStream => "single_stream",
            Self::MultiStream => "multi_stream",
            Self::Offline => "offline",
        })
    }
}

/// A line of `latency.csv`. Empty fields are not measured.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct LatencyRow {
    /// [`FORMAT`].
    pub format: u32,
    /// Name of the model.
    pub model: String,
    /// BLAKE3 of its file.
    pub model_hash: String,
    /// Device asked for.
    pub device: String,
    /// Provider that the nodes were given to.
    pub provider: String,
    /// Runtime and version.
    pub runtime: String,
    /// Threads within the session, and for decoding and resizing.
    pub threads: usize,
    /// Images per run of the session.
    pub batch: usize,
    /// How queries were sent.
    pub scenario: Scenario,
    /// What was timed.
    pub stage: Stage,
    /// Width of the network's input in pixels.
    pub input_width: u32,
    /// Height of the network's input in pixels.
    pub input_height: u32,
    /// Different images that the queries took turns with.
    pub samples: usize,
    /// Queries that were timed.
    pub queries: u64,
    /// Images in them.
    pub images: u64,
    /// Duration of the measurement.
    pub seconds: f64,
    /// Images divided by seconds.
    pub images_per_second: f64,
    /// Mean latency of a query.
    pub mean_ms: Option<f64>,
    /// Shortest latency.
    pub min_ms: Option<f64>,
    /// See [`Latencies`](super::Latencies).
    pub p50_ms: Option<f64>,
    /// See [`Latencies`](super::Latencies).
    pub p90_ms: Option<f64>,
    /// See [`Latencies`](super::Latencies).
    pub p95_ms: Option<f64>,
    /// See [`Latencies`](super::Latencies).
    pub p99_ms: Option<f64>,
    /// Longest latency.
    pub max_ms: Option<f64>,
    /// Largest difference to the accuracy path, relative to the largest value.
    pub max_difference: f32,
    /// Processor of the machine.
    pub processor: String,
    /// Threads that the process could use.
    pub processor_threads: usize,
    /// Version of this program.
    pub tool_version: String,
}

/// Writes rows with a header line.
///
/// # Errors
/// The writer fails.
pub fn write_rows(rows: &[LatencyRow], writer: impl Write) -> io::Result<()> {
    let mut writer = strat_csv::Writer::new(writer);
    for row in rows {
        writer.serialize(row).map_err(io::Error::other)?;
    }
    writer.flush()
}

/// Reads rows back.
///
/// # Errors
/// A column is missing or a value is malformed; the message has the line.
pub fn read_rows(reader: impl Read) -> Result<Vec<LatencyRow>, strat_csv::Error> {
    strat_csv::Reader::new(reader).deserialize()
}

/// The rows for a terminal; latencies in milliseconds per query.
#[must_use]
pub fn table(rows: &[LatencyRow]) -> String {
    let heading = [
        "model", "threads", "batch", "stage", "scenario", "mean ms", "p50", "p90", "p95", "p99",
        "images/s",
    ];
    let mut lines: Vec<Vec<String>> = vec![heading.map(str::to_owned).to_vec()];
    for row in rows {
        let ms = |value: Option<f64>| value.map_or_else(|| "-".to_owned(), |v| format!("{v:.2}"));
        lines.push(vec![
            row.model.clone(),
            row.threads.to_string(),
            row.batch.to_string(),
            row.stage.to_string(),
            row.scenario.to_string(),
            ms(row.mean_ms),
            ms(row.p50_ms),
            ms(row.p90_ms),
            ms(row.p95_ms),
            ms(row.p99_ms),
            format!("{:.2}", row.images_per_second),
        ]);
    }
    let widths: Vec<usize> = (0..heading.len())
        .map(|column| {
            let lengths = lines.iter().map(|line| line[column].chars().count());
            lengths.max().unwrap_or(0)
        })
        .collect();
    let mut text = String::new();
    for line in lines {
        for (column, cell) in line.iter().enumerate() {
            let width = widths[column];
            // Words to the left, numbers to the right.
            let cell = if matches!(column, 0 | 3 | 4) {
                format!("{cell:<width$}")
            } else {
                format!("{cell:>width$}")
            };
            text.push_str(&cell);
            text.push_str("  ");
        }
        text.truncate(text.trim_end().len());
        text.push('\n');
    }
    if let Some(row) = rows.first() {
        text += &format!(
            "{} on {} ({}), {}\n",
            row.runtime, row.device, row.provider, row.processor
        );
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rows_come_back() {
        let row = LatencyRow {
            format: FORMAT,
            model: "a, b".to_owned(),
            model_hash: "00".to_owned(),
            device: "cpu".to_owned(),
            provider: "CPUExecutionProvider".to_owned(),
            runtime: "onnxruntime 1.31.1".to_owned(),
            threads: 2,
            batch: 4,
            scenario: Scenario::Offline,
            stage: Stage::FileToDepth,
            input_width: 512,
            input_height: 256,
            samples: 3,
            queries: 25,
            images: 100,
            seconds: 10.5,
            images_per_second: 9.52,
            mean_ms: None,
            min_ms: None,
            p50_ms: None,
            p90_ms: None,
            p95_ms: None,
            p99_ms: None,
            max_ms: None,
            max_difference: 1e-7,
            processor: "x".to_owned(),
            processor_threads: 2,
            tool_version: "0.1.0".to_owned(),
        };
        let mut bytes = Vec::new();
        write_rows(std::slice::from_ref(&row), &mut bytes).unwrap();
        let text = String::from_utf8(bytes.clone()).unwrap();
        assert!(
            text.starts_with("format,model,model_hash,device,provider,"),
            "{text}"
        );
        assert!(text.contains("offline,file_to_depth"), "{text}");
        assert_eq!(read_rows(bytes.as_slice()).unwrap(), [row]);
        assert!(read_rows(&b"format,model\n1,x\n"[..]).is_err());
    }
}
