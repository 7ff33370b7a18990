//! Layers, refusals and digests of configurations.

use strat_store::set::Content;

use super::resolve::keys;
use super::*;
use crate::loss::Weights;
use crate::network::generator::{Decoder, GeneratorConfig, Head};
use crate::network::layers::Width;

fn resolved(name: &str) -> Config {
    Config::resolve(name, None, &[]).unwrap()
}

/// The defaults with their dependent values written out.
fn base() -> Config {
    let mut config = Config::default();
    config.fill();
    config
}

fn without_discriminator(mut config: Config) -> Config {
    config.variant = Variant::NoAdv;
    config.weights.adversarial = Some(0.0);
    config
}

#[test]
fn the_thesis_configurations_differ_from_the_defaults_as_stated() {
    assert_eq!(resolved("kitti-strat"), base());
    for (name, split) in [("kitti", Content::Kitti), ("eigen", Content::Eigen)] {
        let of = |variant| Config {
            split,
            variant,
            ..base()
        };
        assert_eq!(resolved(&format!("{name}-strat")), of(Variant::Strat));
        assert_eq!(resolved(&format!("{name}-fixed")), of(Variant::Fixed));
        assert_eq!(resolved(&format!("{name}-random")), of(Variant::Random));
        assert_eq!(
            resolved(&format!("{name}-noadv")),
            without_discriminator(of(Variant::NoAdv))
        );
    }
}

#[test]
fn the_monodepth_configuration_is_the_reference_baseline() {
    let mut expected = without_discriminator(base());
    expected.objective = Objective::Monodepth;
    expected.decay = Decay::Halve;
    expected.network = GeneratorConfig {
        decoder: Decoder::NearestConv,
        head: Head::Sigmoid,
        bottleneck: false,
        ..GeneratorConfig::default()
    };
    expected.weights = WeightSettings {
        ssim: Some(0.85),
        l1: Some(0.15),
        left_right: Some(1.0),
        smoothness: Some(0.1),
        adversarial: Some(0.0),
    };
    assert_eq!(resolved("kitti-monodepth"), expected);
}

#[test]
fn the_demo_keeps_the_thesis_method() {
    let demo = resolved("demo");
    assert_eq!(demo.split, Content::Eigen);
    assert_eq!(demo.variant, Variant::Strat);
    assert_eq!(demo.objective, Objective::Strat);
    assert_eq!(demo.loss_weights(), Weights::STRAT);
    assert_eq!(demo.baseline_start, 0.1);
}

#[test]
fn kitti_strat_names_every_setting() {
    // The commented file is the reference of the settings: it must show all of them.
    let (_, text) = BUILT_IN[0];
    let shown: serde_yaml::Value = serde_yaml::from_str(text).unwrap();
    let all = serde_yaml::to_value(Config::default()).unwrap();
    assert_eq!(keys(&shown), keys(&all));
    for key in keys(&all) {
        assert_eq!(
            keys(&shown[key.as_str()]),
            keys(&all[key.as_str()]),
            "{key}"
        );
    }
}

#[test]
fn every_line_of_a_built_in_file_is_preceded_by_or_ends_in_a_comment() {
    for (name, text) in BUILT_IN {
        let mut commented = false;
        for line in text.lines() {
            let line = line.trim();
            if line.is_empty() {
                commented = false;
            } else if line.starts_with('#') {
                commented = true;
            } else {
                assert!(commented || line.contains(" # "), "{name}: `{line}`");
                commented = false;
            }
        }
    }
}

#[test]
fn digests_are_those_of_runs_made_so_far() {
    // config_digest in run.json of runs that were made before there were diagnostics.
    for (name, preset, settings, digest) in [
        (
            "demo",
            None,
            &[][..],
            "50ab8d23480e2cbf8f714f223b7372af1f702b266a8a0e6a2db5b7222a617ab6",
        ),
        (
            "demo",
            None,
            &["epochs=14"],
            "b571cdc4a9c9cc0a4b626867f8d3b8485777e863da17b6f36392f0e629849acb",
        ),
        (
            "eigen-noadv",
            Some(Preset::Tiny),
            &[],
            "6803d5fd4e6127ba079edbb3068333577f031bd9a57b2365a6cfdff268c05041",
        ),
    ] {
        for never in [&[][..], &["diagnostics.every=0"]] {
            let settings = settings.iter().chain(never).map(|s| (*s).to_owned());
            let settings: Vec<String> = settings.collect();
            let config = Config::resolve(name, preset, &settings).unwrap();
            assert_eq!(config.digest().unwrap(), digest, "{name}");
        }
    }
}

#[test]
fn settings_change_one_value_and_refuse_unknown_keys() {
    let settings = [
        "epochs=3".to_owned(),
        "network.width=1/4".to_owned(),
        "augment.gamma=[1.0, 1.0]".to_owned(),
        "max_steps=7".to_owned(),
    ];
    let config = Config::resolve("kitti-strat", None, &settings).unwrap();
    assert_eq!(config.epochs, 3);
    assert_eq!(config.network.width, Width::new(1, 4).unwrap());
    assert_eq!(config.augment.gamma, [1.0, 1.0]);
    assert_eq!(config.max_steps, Some(7));
    for (setting, part) in [
        ("epoch=3", "`epoch`"),
        ("network.depth=3", "`depth`"),
        ("epochs.x=3", "nothing is below"),
        ("network=3", "group of settings"),
        ("epochs", "key=value"),
        ("epochs=many", "epochs"),
        ("batch=0", "`batch`"),
        ("input.width=500", "`input.width`"),
        ("weights.adversarial=0", "no-adv"),
        ("learning_rate=.nan", "`learning_rate`"),
        ("variant=best", "variant"),
    ] {
        let message = Config::resolve("kitti-strat", None, &[setting.to_owned()])
            .expect_err(setting)
            .to_string();
        assert!(message.contains(part), "{setting}: {message}");
    }
}

#[test]
fn an_unknown_key_in_a_file_is_named_with_its_line() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("mine.yaml");
    std::fs::write(&path, "split: eigen\nepochs: 3\nlearning_rates: 0.1\n").unwrap();
    let message = Config::load(path.to_str().unwrap())
        .unwrap_err()
        .to_string();
    assert!(message.contains("learning_rates"), "{message}");
    assert!(message.contains("line 3"), "{message}");
    assert!(message.contains("mine.yaml"), "{message}");
}

#[test]
fn presets_set_the_sizes_only() {
    for (name, preset) in Preset::ALL {
        assert_eq!(name.parse::<Preset>().unwrap(), preset);
        let config = Config::resolve("eigen-fixed", Some(preset), &[]).unwrap();
        let expected = Config {
            network: GeneratorConfig {
                width: config.network.width,
                ..GeneratorConfig::default()
            },
            discriminator: config.discriminator,
            input: config.input,
            batch: config.batch,
            ..resolved("eigen-fixed")
        };
        assert_eq!(config, expected, "{name}");
    }
    assert!("huge".parse::<Preset>().is_err());
}

#[test]
fn the_printed_configuration_reads_back_as_itself() {
    let config = resolved("kitti-monodepth");
    let text = config.to_yaml().unwrap();
    let again: Config = serde_yaml::from_str(&text).unwrap();
    assert_eq!(again, config);
}

#[test]
fn the_digest_covers_what_decides_the_weights_only() {
    let config = base();
    let digest = config.digest().unwrap();
    for (setting, same) in [
        ("workers=7", true),
        ("max_steps=7", true),
        ("checkpoint.keep=7", true),
        ("seed=7", false),
        ("network.head=sigmoid", false),
    ] {
        let other = config.with_setting(setting).unwrap().digest().unwrap();
        assert_eq!(other == digest, same, "{setting}");
    }
}

#[test]
fn protocols_that_validation_cannot_score_are_refused() {
    for (protocol, part) in [
        ("eigen-90", "not a known protocol"),
        ("kitti2015", "stereo disparity"),
        ("make3d-c1", "laser"),
        ("eigen-80-distance", "parts of an image"),
        ("eigen-80-pp", "twice"),
        ("eigen-kb-garg", "shows the network a crop"),
    ] {
        let setting = format!("validation.protocol={protocol}");
        let message = Config::resolve("kitti-strat", None, &[setting]).expect_err(protocol);
        let message = message.to_string();
        assert!(
            message.contains(part) && message.contains(protocol),
            "{message}"
        );
    }
    for protocol in ["eigen-80", "eigen-50", "eigen-improved", "eigen-80-median"] {
        let setting = format!("validation.protocol={protocol}");
        assert!(
            Config::resolve("kitti-strat", None, &[setting]).is_ok(),
            "{protocol}"
        );
    }
}

#[test]
fn names_of_earlier_versions_still_work() {
    let old = [
        "discriminator.judges=per-view",
        "start_weights=w.safetensors",
    ]
    .map(str::to_owned);
    let new = [
        "discriminator.sharing=per-view",
        "initial_weights=w.safetensors",
    ];
    let config = Config::resolve("kitti-strat", None, &old).unwrap();
    assert_eq!(
        config,
        Config::resolve("kitti-strat", None, &new.map(str::to_owned)).unwrap()
    );
    assert_eq!(config.discriminator.sharing, Sharing::PerView);
    let text = config.to_yaml().unwrap();
    let text = text
        .replace("sharing:", "judges:")
        .replace("initial_weights:", "start_weights:");
    assert!(
        text.contains("judges: per-view") && text.contains("start_weights: w"),
        "{text}"
    );
    assert_eq!(serde_yaml::from_str::<Config>(&text).unwrap(), config);
}
