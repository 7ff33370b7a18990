//! `bench setup`: installs ONNX Runtime.

use std::path::PathBuf;

use clap::Args;
use strat_store::command::{DONE, eprint_line, print_line};

use crate::runtime::{
    ffi,
    install::{self, SetupOptions},
    search::{ONNXRUNTIME_VERSION, SearchPaths},
};

#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  bench setup                the CPU build, 70 MB
  bench setup --gpu          CUDA, about 2.5 GB")]
pub(super) struct SetupArgs {
    /// The CUDA build and the CUDA 13 libraries (about 2.5 GB) instead of the CPU build (70 MB)
    #[arg(long)]
    gpu: bool,
    /// Install below this folder instead of STRAT_HOME or the user's data folder
    #[arg(long, value_name = "DIR")]
    dir: Option<PathBuf>,
}

pub(super) fn run(args: &SetupArgs) -> anyhow::Result<u8> {
    let paths = SearchPaths::of_this_process();
    let options = SetupOptions {
        gpu: args.gpu,
        root: args.dir.clone(),
    };
    if install::installed(&options, &paths)?.is_none() {
        let size = if args.gpu {
            "CUDA, about 2.5 GB"
        } else {
            "CPU, about 70 MB"
        };
        eprint_line(format_args!(
            "installing ONNX Runtime {} ({size}) ...",
            ONNXRUNTIME_VERSION
        ));
    }
    let installed = install::install(&options, &paths)?;
    let version = ffi::onnxruntime_version(&installed.library).map_err(|reason| {
        anyhow::anyhow!(
            "the library in {} cannot be opened: {reason}",
            installed.library.display()
        )
    })?;
    print_line(installed.library.display())?;
    eprint_line(format_args!(
        "ONNX Runtime {version} is {} {}; `bench` finds it there from now on, and deleting the \
         folder undoes this",
        if installed.already_there {
            "already in"
        } else {
            "now in"
        },
        installed.folder.display()
    ));
    if let Some(root) = &args.dir {
        // A folder of the user's own is found only when it is named.
        eprint_line(format_args!(
            "next: to have it found, set STRAT_HOME={} (or ORT_DYLIB_PATH={})",
            root.display(),
            installed.library.display()
        ));
    } else {
        eprint_line(
            "next: `bench devices` shows what models can run on; bench eval --table all --data SET -m MODEL.onnx \
             -o results",
        );
    }
    Ok(DONE)
}
