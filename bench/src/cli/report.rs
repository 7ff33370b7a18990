//! `bench report`: one page about all results below a folder.

use std::path::PathBuf;

use clap::Args;
use strat_store::{
    claim,
    command::{DONE, FAILED, eprint_line, print},
    files,
};

use crate::report;

#[derive(Debug, Args)]
#[command(after_help = "\
The folder may hold several runs, in folders of their own: rows.csv with run.yaml and pictures (of
`bench --table`), latency.csv (of `bench latency`) and cues.csv (of `bench cues`).

Examples:
  bench eval --table all --data set --model model.onnx --protocol kitti2015-distance --extremes 3 --out results/kitti
  bench latency --model model.onnx --images photos --out results/speed
  bench cues --data set --model model.onnx --out results/cues
  bench report results")]
pub(super) struct ReportArgs {
    /// Folder of results
    folder: PathBuf,
    /// The page [default: report.html in the folder]
    #[arg(short, long, value_name = "FILE.html")]
    out: Option<PathBuf>,
    /// Title of the page
    #[arg(long, default_value = "Depth estimation report")]
    title: String,
}

pub(super) fn run(args: &ReportArgs) -> anyhow::Result<u8> {
    let out = args
        .out
        .clone()
        .unwrap_or_else(|| args.folder.join("report.html"));
    claim::check_file(&out, &[], "bench report", report::BEGINS)?;
    let collected = report::collect(&args.folder)?;
    let page = report::render(&args.title, &collected);
    files::write_atomic(&out, page.html.as_bytes())?;
    for problem in &page.problems {
        eprint_line(format_args!("error: {problem}"));
    }
    print(format_args!("{}\n", out.display()))?;
    Ok(if page.problems.is_empty() {
        DONE
    } else {
        FAILED
    })
}
