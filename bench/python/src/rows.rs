//! Rows, and what is a function of them alone.

use std::path::PathBuf;

use pyo3::IntoPyObjectExt as _;
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use pyo3::types::{PyDict, PyList};
use strat_bench::evaluate::{plan, write};
use strat_bench::rows::{compare, leaderboard};
use strat_metrics::compare::TestOptions;
use strat_metrics::rows::{self, COLUMNS};
use strat_metrics::tables::{Coverage, Source, Table};
use strat_metrics::{Row, leaderboard as lines};
use strat_store::files;

use crate::errors::raised;

/// Columns of rows that say what was measured; the others are numbers.
const CONTEXT: [&str; 10] = [
    "model",
    "model_hash",
    "variant",
    "data_digest",
    "protocol_digest",
    "split",
    "image",
    "runtime",
    "provider",
    "tool_version",
];

/// Lines of `rows.csv` with the size of the test set they belong to.
#[pyclass(frozen, module = "strat._strat")]
pub struct Rows {
    pub rows: Vec<Row>,
    pub coverage: Coverage,
}

#[pymethods]
impl Rows {
    fn __len__(&self) -> usize {
        self.rows.len()
    }

    /// All rows by column.
    fn columns<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        let cells: Vec<Vec<String>> = self.rows.iter().map(Row::cells).collect();
        let columns = PyDict::new(py);
        let written = rows::columns_of(&self.rows);
        let written = |(_, name): &(usize, &&str)| written.contains(*name);
        for (index, name) in COLUMNS.iter().enumerate().filter(written) {
            let values = PyList::empty(py);
            for row in &cells {
                values.append(cell(py, name, &row[index])?)?;
            }
            columns.set_item(name, values)?;
        }
        Ok(columns)
    }

    /// The bytes of `rows.csv`.
    fn write(&self, path: PathBuf) -> PyResult<()> {
        let mut bytes = Vec::new();
        rows::write(&self.rows, &mut bytes).map_err(raised)?;
        files::write_atomic(&path, &bytes).map_err(raised)
    }

    /// The thesis' tables that the rows fill.
    fn table(&self, py: Python<'_>, format: &str) -> PyResult<String> {
        type Form = fn(&Table) -> Result<String, strat_metrics::CsvError>;
        let form: Form = match format {
            "text" => |table| Ok(table.text()),
            "markdown" => |table| Ok(table.markdown()),
            "latex" => |table| Ok(table.latex()),
            "csv" => Table::csv,
            _ => {
                return Err(PyValueError::new_err(format!(
                    "unknown format \"{format}\"; known: text, markdown, latex and csv"
                )));
            }
        };
        py.detach(|| {
            let measured = compare::protocols_of(&self.rows);
            let wanted = plan::tables_showing(measured.iter().map(String::as_str));
            if wanted.is_empty() {
                return Err(PyValueError::new_err(plan::no_table_shows(&measured)));
            }
            let tables = write::tables_of(&wanted, &self.rows, &self.coverage).map_err(raised)?;
            let texts: Result<Vec<String>, _> =
                tables.iter().map(|(_, table)| form(table)).collect();
            Ok(texts.map_err(raised)?.join("\n"))
        })
    }

    /// The lines of `leaderboard.csv`, a dict each.
    fn leaderboard<'py>(&self, py: Python<'py>) -> PyResult<Vec<Bound<'py, PyDict>>> {
        let entries = py.detach(|| {
            write::leaderboard_of(&self.rows, self.coverage.expected_images).map_err(raised)
        })?;
        let line = |entry: &lines::Entry| {
            let line = PyDict::new(py);
            for (name, text) in lines::COLUMNS.iter().zip(entry.cells()) {
                line.set_item(name, cell(py, name, &text)?)?;
            }
            Ok(line)
        };
        entries.iter().map(line).collect()
    }

    /// Paired tests between models, as JSON and as text.
    #[pyo3(signature = (protocol, model_a, model_b, draws, seed, metrics))]
    #[allow(clippy::too_many_arguments, reason = "Python names each of them")]
    fn compare(
        &self,
        py: Python<'_>,
        protocol: Option<&str>,
        model_a: Option<&str>,
        model_b: Option<&str>,
        draws: u32,
        seed: u64,
        metrics: bool,
    ) -> PyResult<(String, String)> {
        let options = TestOptions {
            permutations: draws,
            seed,
        };
        py.detach(|| {
            let tests = compare::pairs(&self.rows, protocol, model_a, model_b, metrics, &options);
            let tests = tests.map_err(raised)?;
            let json = serde_json::to_string(&tests).map_err(raised)?;
            Ok((json, compare::text(&tests, &options)))
        })
    }
}

/// Reads rows files as one; the `run.yaml` beside the first says how many images there should be.
#[pyfunction]
pub fn read_rows(py: Python<'_>, paths: Vec<PathBuf>) -> PyResult<Rows> {
    py.detach(|| {
        // Several files are sorted; one keeps its order.
        let rows = match paths.as_slice() {
            [only] => compare::read_rows(only),
            _ => compare::read_all(&paths),
        };
        let rows = rows.map_err(raised)?;
        let coverage = match paths.first() {
            Some(first) => leaderboard::coverage_of(first, &rows).map_err(raised)?,
            None => Coverage {
                expected_images: 0,
                source: Source::Unknown,
            },
        };
        Ok(Rows { rows, coverage })
    })
}

/// Several rows as one; the first says how many images there should be.
#[pyfunction]
pub fn merge_rows(parts: Vec<PyRef<'_, Rows>>) -> PyResult<Rows> {
    let coverage = parts.first().map_or(
        Coverage {
            expected_images: 0,
            source: Source::Unknown,
        },
        |first| first.coverage.clone(),
    );
    let rows = parts.iter().map(|part| part.rows.clone());
    let rows = rows::merge(rows.collect::<Vec<_>>()).map_err(raised)?;
    Ok(Rows { rows, coverage })
}

/// What a row has measured, by the columns of `rows.csv`.
pub fn score_dict<'py>(py: Python<'py>, row: &Row) -> PyResult<Bound<'py, PyDict>> {
    let dict = PyDict::new(py);
    for (name, text) in COLUMNS.iter().zip(row.cells()) {
        if !CONTEXT.contains(name) {
            dict.set_item(name, cell(py, name, &text)?)?;
        }
    }
    Ok(dict)
}

/// A cell as a number where its column has numbers; `None` where it is empty.
fn cell<'py>(py: Python<'py>, column: &str, text: &str) -> PyResult<Bound<'py, PyAny>> {
    const TEXTS: [&str; 6] = [
        "protocol",
        "group",
        "method",
        "origin",
        "citation",
        "intervals",
    ];
    const COUNTS: [&str; 5] = [
        "pixels",
        "floored_pixels",
        "images",
        "expected_images",
        "schema",
    ];
    if text.is_empty() {
        return Ok(py.None().into_bound(py));
    }
    if COUNTS.contains(&column) {
        let count: u64 = text.parse().map_err(raised)?;
        return count.into_bound_py_any(py);
    }
    if CONTEXT.contains(&column) || TEXTS.contains(&column) {
        return text.into_bound_py_any(py);
    }
    let number: f64 = text.parse().map_err(raised)?;
    number.into_bound_py_any(py)
}
