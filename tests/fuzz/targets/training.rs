//! What `train` is given: settings, studies, initial weights.
#![no_main]

mod damage;

use std::path::Path;
use std::sync::LazyLock;

use libfuzzer_sys::fuzz_target;
use strat_train::config::Config;
use strat_train::network::initial_weights::{self, InitialWeights, Parameter};
use strat_train::study::file::StudyFile;
use tempfile::TempDir;

static FOLDER: LazyLock<TempDir> = LazyLock::new(|| tempfile::tempdir().expect("a folder"));
static SETTINGS: LazyLock<String> = LazyLock::new(|| {
    let config = Config::resolve("kitti-strat", None, &[]).expect("a configuration of our own");
    config.to_yaml().expect("it is written")
});
static WEIGHTS: LazyLock<Vec<u8>> = LazyLock::new(|| {
    let parameter = |name: &str, shape: Vec<usize>| Parameter {
        name: name.to_owned(),
        values: vec![0.25; shape.iter().product()],
        shape,
    };
    let parameters = [
        parameter("encoder.conv1.weight", vec![2, 1, 3, 3]),
        parameter("encoder.conv1.bias", vec![2]),
    ];
    let path = FOLDER.path().join("w.safetensors");
    let drives = ["2011_09_26_drive_0001".to_owned()];
    initial_weights::write(&parameters, Some(&drives), &path).expect("weights are written");
    std::fs::read(path).expect("own file")
});
const STUDY: &str = "base: kitti-strat\npreset: tiny\nsettings: {epochs: 2, discriminator: {sharing: own}}\n\
    variants: {a: {variant: no-adv}, b: {variant: strat, network.width: 1/4}}\nseeds: [1, 2]\n\
    data: [prepared/kitti]\nevaluation: {table: \"3.1\"}\n";
const VALUES: [&str; 4] = ["epochs", "network.width", "augment.gamma", "learning_rate"];

fuzz_target!(|data: &[u8]| {
    let Some((which, data)) = data.split_first() else {
        return;
    };
    let path = FOLDER.path().join("x.yaml");
    let source = path.to_str().expect("a path of letters");
    match which % 4 {
        0 => {
            std::fs::write(&path, damage::damaged(SETTINGS.as_bytes(), data)).expect("written");
            if let Ok(config) = Config::resolve(source, None, &[]) {
                // What was accepted is written beside the weights and read again by `--resume`.
                let digest = config.digest().expect("a digest");
                std::fs::write(&path, config.to_yaml().expect("written")).expect("written");
                let again = Config::resolve(source, None, &[]).expect("its own words are read");
                assert_eq!(again.digest().expect("a digest"), digest);
            }
        }
        1 => {
            std::fs::write(&path, damage::damaged(STUDY.as_bytes(), data)).expect("written");
            if let Ok(study) = StudyFile::load(source) {
                for (_, settings) in &study.variants {
                    let _ = Config::resolve(&study.base, study.preset, settings);
                }
            }
        }
        2 => {
            let Some((key, value)) = data.split_first() else {
                return;
            };
            let key = VALUES[usize::from(*key) % VALUES.len()];
            let setting = format!("{key}={}", String::from_utf8_lossy(value));
            let _ = Config::resolve("demo", None, &[setting]);
        }
        _ => {
            let bytes = damage::damaged(&WEIGHTS, data);
            if let Ok(read) = InitialWeights::parse(&bytes, Path::new("w.safetensors"))
                && let Some(values) = read.values("encoder.conv1.weight", &[2, 1, 3, 3])
            {
                assert_eq!(values.len(), 18);
                assert!(values.iter().all(|value| value.is_finite()));
            }
        }
    }
});
