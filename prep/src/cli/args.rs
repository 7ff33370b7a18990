//! Options that several subcommands share.

use std::path::PathBuf;
use std::str::FromStr;

use strat_splits::Role;
use strat_store::command::CliError;
use strat_store::image_files::{Codec, DEFAULT_QUALITY};
use strat_store::resize::Kernel;
use strat_store::shard::Shard;

use crate::set::settings::ImageOptions;
use crate::set::writer::SetOptions;

/// How network-size images are made and stored.
#[derive(Debug, clap::Args)]
pub(super) struct ImageArgs {
    /// Width in pixels of the network-size images.
    #[arg(long, default_value_t = 512, value_parser = clap::value_parser!(u32).range(8..=8192))]
    width: u32,
    /// Height in pixels of the network-size images.
    #[arg(long, default_value_t = 256, value_parser = clap::value_parser!(u32).range(8..=8192))]
    height: u32,
    /// Resize kernel: area (as the thesis' code), bilinear or lanczos3.
    #[arg(long, default_value_t = Kernel::Area)]
    kernel: Kernel,
    /// How network-size images are stored: png (without loss) or jpeg (4:2:0, a fraction of the size).
    #[arg(long, value_name = "CODEC", default_value = "png")]
    codec: CodecName,
    /// Quality of --codec jpeg, from 1 to 100 [default: 92].
    #[arg(long, value_name = "Q", value_parser = clap::value_parser!(u8).range(1..=100))]
    quality: Option<u8>,
}

/// `png`, `jpeg`, or `jpeg-92` with the quality, as manifests have it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum CodecName {
    Png,
    Jpeg(Option<u8>),
}

impl FromStr for CodecName {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        match (text, text.parse()) {
            ("jpeg", _) => Ok(Self::Jpeg(None)),
            (_, Ok(Codec::Png)) => Ok(Self::Png),
            (_, Ok(Codec::Jpeg(quality))) => Ok(Self::Jpeg(Some(quality))),
            (_, Err(_)) => Err("the codecs are png and jpeg".to_owned()),
        }
    }
}

impl ImageArgs {
    /// The images as asked for.
    ///
    /// # Errors
    /// `--codec` and `--quality` contradict each other.
    pub fn options(&self) -> Result<ImageOptions, CliError> {
        Ok(ImageOptions {
            width: self.width,
            height: self.height,
            kernel: self.kernel,
            codec: self.codec()?,
        })
    }

    fn codec(&self) -> Result<Codec, CliError> {
        match (self.codec, self.quality) {
            (CodecName::Png, None) => Ok(Codec::Png),
            (CodecName::Png, Some(_)) => Err(CliError::Usage(
                "--quality is for --codec jpeg; PNG loses nothing".to_owned(),
            )),
            (CodecName::Jpeg(Some(named)), Some(quality)) if named != quality => {
                Err(CliError::Usage(format!(
                    "--codec jpeg-{named} and --quality {quality} contradict each other; give one of them"
                )))
            }
            (CodecName::Jpeg(named), quality) => {
                Ok(Codec::Jpeg(quality.or(named).unwrap_or(DEFAULT_QUALITY)))
            }
        }
    }
}

/// Options of every subcommand that makes a set.
#[derive(Debug, clap::Args)]
pub(super) struct SetArgs {
    #[command(flatten)]
    images: ImageArgs,
    /// Prepare only one of N parts, numbered from 0; `prep merge` makes a set of all of them.
    #[arg(long, value_name = "I/N")]
    shard: Option<Shard>,
    #[command(flatten)]
    jobs: JobsArg,
    /// Show no progress.
    #[arg(short, long)]
    quiet: bool,
    /// Folder to write to: new, empty, or of an earlier run with the same options.
    #[arg(short, long, value_name = "DIR")]
    out: PathBuf,
}

impl SetArgs {
    /// The set as asked for.
    ///
    /// # Errors
    /// The options contradict each other.
    pub fn options(&self) -> Result<SetOptions, CliError> {
        Ok(SetOptions {
            out: self.out.clone(),
            images: self.images.options()?,
            shard: self.shard,
            threads: self.jobs.threads(),
            quiet: self.quiet,
        })
    }
}

/// How many threads.
#[derive(Debug, clap::Args)]
pub(super) struct JobsArg {
    /// Threads to use [default: all cores].
    #[arg(long, value_name = "N", value_parser = parse_jobs)]
    jobs: Option<usize>,
}

impl JobsArg {
    /// Threads; 0 for one for each core.
    pub fn threads(&self) -> usize {
        self.jobs.unwrap_or(0)
    }
}

pub(super) fn parse_role(text: &str) -> Result<Role, String> {
    let role = Role::ALL.into_iter().find(|role| role.as_str() == text);
    role.ok_or_else(|| "the roles are train, val and test".to_owned())
}

fn parse_jobs(text: &str) -> Result<usize, String> {
    let jobs = text.parse().ok().filter(|jobs| (1..=4096).contains(jobs));
    jobs.ok_or_else(|| "give a number of threads from 1 to 4096".to_owned())
}

#[cfg(test)]
mod tests {
    use clap::Parser;

    use super::*;

    #[derive(Parser)]
    struct Line {
        #[command(flatten)]
        images: ImageArgs,
    }

    fn codec(line: &str) -> Result<Codec, String> {
        let line = Line::try_parse_from(line.split_whitespace()).map_err(|e| e.to_string())?;
        line.images.codec().map_err(|e| e.to_string())
    }

    #[test]
    fn codecs_are_named_in_both_ways() {
        for (line, expected) in [
            ("prep", Codec::Png),
            ("prep --codec png", Codec::Png),
            ("prep --codec jpeg", Codec::Jpeg(92)),
            ("prep --codec jpeg --quality 80", Codec::Jpeg(80)),
            ("prep --codec jpeg-80", Codec::Jpeg(80)),
            ("prep --codec jpeg-80 --quality 80", Codec::Jpeg(80)),
        ] {
            assert_eq!(codec(line), Ok(expected), "{line}");
        }
        for (line, reason) in [
            ("prep --quality 92", "PNG loses nothing"),
            ("prep --codec jpeg-80 --quality 81", "contradict each other"),
            ("prep --codec jpeg-0", "png and jpeg"),
            ("prep --codec webp", "png and jpeg"),
            ("prep --codec jpeg --quality 101", "101"),
        ] {
            let problem = codec(line).unwrap_err();
            assert!(problem.contains(reason), "{line}: {problem}");
        }
    }
}
