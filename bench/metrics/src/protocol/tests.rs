use std::collections::BTreeSet;

use super::*;

const MEDIAN: Suffix = Suffix::Align(Alignment::Median);

#[test]
fn names_are_found_and_digests_differ() {
    let all = protocols();
    for known in &all {
        assert_eq!(protocol(&known.name).as_ref(), Some(known));
    }
    let digests: BTreeSet<String> = all.iter().map(Protocol::digest).collect();
    assert_eq!((all.len(), digests.len()), (16, 16));
    assert!(all.iter().all(|known| known.check().is_ok()));
    assert_eq!(protocol("eigen"), None);
}

/// A failing line here means that the meaning of rows measured so far has changed: raise
/// the version of the protocol. Recipe: BLAKE3 of the canonical text, first run.
#[test]
fn digests_of_the_tables_protocols_stay() {
    let digest = |name| protocol(name).unwrap().digest();
    assert_eq!(
        ["kitti2015", "semantic", "eigen-80", "eigen-50"].map(digest),
        [
            "a569e08a7e07ac2d32b57a77b85b605f0e5032c44a71f3e848373bc9b4eaa889",
            "300e54cd800567fa66dd8bce13bfe06e92924f454f49d823b38fd054e2366f88",
            "2bc91e5df36c305fb69912f774374ae1a5a54c2debb6d83c21bef3b25cbfa8db",
            "c64c43f21b30cf5fbc3105033b6770af18a5e803b1fc426dc7974275877ab049",
        ]
    );
}

#[test]
fn the_canonical_text_names_every_choice() {
    assert_eq!(
        protocol("eigen-80").unwrap().canonical_text(),
        "name=eigen-80\nversion=1\nground_truth=velodyne-x\ncamera=calibrated\n\
         crop=truncate,0.40810811,0.99189189,0.03594771,0.96405229\nmin_depth_m=0.001\n\
         max_depth_m=80.0\nmask_ground_truth=true\nstrict_comparisons=true\n\
         disparity_floor_fraction=0.0001\ninfinite_depth=near-limit\nmedian_scaling=false\n\
         post_processing=none\nd1=none\ngrouping=none\nresize=disparity,bilinear\n\
         averaging=unweighted-mean-over-images\n"
    );
}

#[test]
fn suffixes_change_the_rules() {
    let both = protocol("eigen-80-pp-median").unwrap();
    assert!(both.alignment == Alignment::Median && both.post_processing == PostProcessing::Flip);
    assert_eq!(both.name, "eigen-80-pp-median");
    assert_ne!(both.digest(), protocol("eigen-80-pp").unwrap().digest());
    assert_eq!(protocol("eigen-80-pp-pp"), None);
    assert_eq!(protocol("eigen-80-median-median"), None);
    assert_eq!(protocol("-median"), None);

    let bare = protocol("eigen-80-nocrop-pp").unwrap();
    assert_eq!(
        (bare.crop, bare.name.as_str()),
        (Crop::None, "eigen-80-nocrop-pp")
    );
    let eigen = protocol("eigen-50-eigencrop").unwrap();
    assert_eq!((eigen.crop, eigen.max_depth_m), (Crop::Eigen, 50.0));
    // Its own crop is no variant, and there cannot be two.
    assert_eq!(protocol("eigen-80-garg"), None);
    assert_eq!(protocol("kitti2015-nocrop"), None);
    assert_eq!(protocol("eigen-80-nocrop-eigencrop"), None);
    let far = protocol("eigen-80-distance-median").unwrap();
    assert!(far.grouping == Grouping::Distance && far.alignment == Alignment::Median);
    assert_eq!(protocol("semantic-distance"), None);
    assert_eq!(protocol("eigen-80-distance-distance"), None);
    // The scale of Make3D is always the median's.
    assert_eq!(protocol("make3d-c1-median"), None);
}

/// All sets of suffixes in all orders: one protocol, one name, one digest. By hand: one of three
/// crops, with or without flip and distance, one of six alignments, less the plain name: 3 * 2 * 2 *
/// 6 - 1 = 71 protocols. Spellings: sets of n suffixes have n! each. Of the four kinds (two crops, flip,
/// distance, five alignments) there are 9 sets of one, 2 * 1 + 2 * 1 + 2 * 5 + 1 + 5 + 5 = 25 of two,
/// 2 + 10 + 10 + 5 = 27 of three and 10 of four: 9 + 25 * 2 + 27 * 6 + 10 * 24 = 461.
#[test]
fn every_order_of_suffixes_is_the_same_protocol() {
    fn spellings(name: &str, left: &[Suffix], all: &mut Vec<String>) {
        for (index, suffix) in left.iter().enumerate() {
            let longer = format!("{name}{}", suffix.as_str());
            let mut rest = left.to_vec();
            rest.remove(index);
            match suffix {
                Suffix::Crop(_) => rest.retain(|other| !matches!(other, Suffix::Crop(_))),
                Suffix::Align(_) => rest.retain(|other| !matches!(other, Suffix::Align(_))),
                Suffix::Flip | Suffix::Distance => {}
            }
            all.push(longer.clone());
            spellings(&longer, &rest, all);
        }
    }
    let own = Suffix::Crop(Crop::Garg);
    let left: Vec<Suffix> = Suffix::ALL.into_iter().filter(|s| *s != own).collect();
    let mut all = Vec::new();
    spellings("eigen-80", &left, &mut all);
    assert_eq!(all.len(), 461);
    let mut made: BTreeSet<(String, String)> = BTreeSet::new();
    for spelling in &all {
        let rules = protocol(spelling).unwrap();
        assert_eq!(rules.check(), Ok(()), "{spelling}");
        assert_eq!(protocol(&rules.name).as_ref(), Some(&rules), "{spelling}");
        // What a model of unknown scale makes of it.
        if rules.alignment == Alignment::None {
            let scaled = rules.clone().with(MEDIAN);
            assert!(scaled.name.ends_with("-median") && protocol(&scaled.name) == Some(scaled));
        }
        made.insert((rules.digest(), rules.name));
    }
    let names: BTreeSet<&String> = made.iter().map(|(_, name)| name).collect();
    assert_eq!((made.len(), names.len()), (71, 71));
    // No base may end like a suffix, or its name would be taken apart.
    for known in protocols() {
        assert_eq!(ProtocolName::parse(&known.name).base(), known.name);
    }
}

/// What a protocol aligns is part of its digest, and only where it is not an old habit of its text.
#[test]
fn alignments_are_part_of_the_rules() {
    let affine = protocol("eigen-80-affine-disparity").unwrap();
    assert_eq!(affine.alignment, Alignment::AffineDisparity);
    assert!(
        affine
            .canonical_text()
            .ends_with("images\nalignment=affine-disparity\n")
    );
    assert!(affine.describe().contains("both have seen the truth"));
    let names = Alignment::ALL.map(|alignment| match Suffix::of_alignment(alignment) {
        Some(suffix) => format!("eigen-80{}", suffix.as_str()),
        None => "eigen-80".to_owned(),
    });
    let digests: BTreeSet<String> = names
        .iter()
        .map(|n| protocol(n).unwrap().digest())
        .collect();
    assert_eq!(digests.len(), Alignment::ALL.len());
    // Nothing takes an alignment away or contradicts one by least squares.
    let none = Suffix::Align(Alignment::None);
    assert_eq!(affine.clone().with(none), affine);
    assert_eq!(affine.clone().with(MEDIAN), affine);
    for wrong in [
        "eigen-80-median-affine-depth",
        "eigen-affine-depth-median",
        "eigen-affine-depth-affine-depth",
    ] {
        assert_eq!(protocol(wrong), None, "{wrong}");
    }
    let make3d = protocol("make3d-c1-affine-disparity").unwrap();
    assert_eq!(make3d.alignment, Alignment::AffineDisparity);
}

/// The table of PROTOCOL 10.4.
#[test]
fn protocols_of_newer_models() {
    for (name, crop, min_depth_m, benchmark_crop, alignment) in [
        (
            "eigen-improved-garg",
            Crop::Garg,
            1e-3,
            BenchmarkCrop::None,
            Alignment::None,
        ),
        (
            "eigen-kb-garg",
            Crop::Garg,
            1e-3,
            BenchmarkCrop::Image,
            Alignment::None,
        ),
        (
            "eigen-affine-disparity",
            Crop::Eigen,
            1e-5,
            BenchmarkCrop::ImageAndTruth,
            Alignment::AffineDisparity,
        ),
        (
            "eigen-affine-depth",
            Crop::Eigen,
            1e-5,
            BenchmarkCrop::ImageAndTruth,
            Alignment::AffineDepth,
        ),
    ] {
        let rules = protocol(name).unwrap();
        assert_eq!(rules.ground_truth, GroundTruthKind::Annotated);
        assert_eq!(
            (rules.crop, rules.benchmark_crop),
            (crop, benchmark_crop),
            "{name}"
        );
        assert_eq!(
            (rules.min_depth_m, rules.max_depth_m),
            (min_depth_m, 80.0),
            "{name}"
        );
        assert_eq!(rules.alignment, alignment, "{name}");
        assert!(
            rules.mask_ground_truth && rules.strict_comparisons,
            "{name}"
        );
    }
    let kb = protocol("eigen-kb-garg").unwrap();
    assert!(kb.canonical_text().ends_with("\nbenchmark_crop=image\n"));
    assert!(kb.describe().contains("goes back to its place"));
}

/// Runs and files of earlier versions say `median_scaling`.
#[test]
fn old_words_of_alignment_are_read() {
    let text = serde_yaml::to_string(&protocol("eigen-80-median").unwrap()).unwrap();
    assert!(text.contains("alignment: median"), "{text}");
    for (old, alignment) in [("true", Alignment::Median), ("false", Alignment::None)] {
        let old = text.replace("alignment: median", &format!("median_scaling: {old}"));
        let read: Protocol = serde_yaml::from_str(&old).unwrap();
        assert_eq!(read.alignment, alignment);
    }
    let wrong = text.replace("alignment: median", "alignment: affine");
    let error = serde_yaml::from_str::<Protocol>(&wrong)
        .unwrap_err()
        .to_string();
    assert!(error.contains("affine-disparity"), "{error}");
}

/// A name in a file of the user's own is not known here; its suffixes still find their places.
#[test]
fn names_of_ones_own_take_suffixes_too() {
    let mine = Protocol {
        name: "mine".to_owned(),
        ..protocol("eigen-80").unwrap()
    };
    let both = mine.with(MEDIAN).with(Suffix::Flip);
    assert_eq!(both.name, "mine-pp-median");
    assert_eq!(both.clone().with(MEDIAN), both);
    let name = ProtocolName::parse("mine-median-pp");
    assert_eq!((name.base(), name.has(Suffix::Flip)), ("mine", true));
    assert_eq!(name.without(MEDIAN).to_string(), "mine-pp");
}

/// Rows of an earlier version may name a protocol in any order of suffixes, under a digest that
/// covers that name.
#[test]
fn old_spellings_are_translated_with_their_digest() {
    let rules = protocol("eigen-80-median-pp").unwrap();
    let old = Protocol {
        name: "eigen-80-median-pp".to_owned(),
        ..rules.clone()
    };
    let new = (rules.name.clone(), rules.digest());
    assert_eq!(canonical(&old.name, &old.digest()), Some(new));
    // Another definition stays what it is, and so does a name that is right already.
    assert_eq!(canonical(&old.name, &rules.digest()), None);
    assert_eq!(canonical(&rules.name, &rules.digest()), None);
    assert_eq!(canonical("mine-median-pp", &old.digest()), None);
}

#[test]
fn differences_are_told_in_sentences() {
    let [a, b, m] = ["eigen-80", "eigen-50", "eigen-80-median"].map(|n| protocol(n).unwrap());
    assert!(a.difference(&a).is_empty());
    assert_eq!(
        a.difference(&b),
        [
            (
                "Pixels: true depth strictly between 0.001 m and 80 m.".to_owned(),
                "Pixels: true depth strictly between 0.001 m and 50 m.".to_owned()
            ),
            (
                "Clip: predictions to 0.001 m .. 80 m.".to_owned(),
                "Clip: predictions to 0.001 m .. 50 m.".to_owned()
            ),
        ]
    );
    let scale = a.difference(&m);
    assert!(scale.len() == 1 && scale[0].0.is_empty() && scale[0].1.starts_with("Scale:"));
    // No two protocols may be told apart by their digests only.
    for x in protocols() {
        for y in protocols().iter().filter(|y| y.name != x.name) {
            assert!(!x.difference(y).is_empty(), "{} and {}", x.name, y.name);
        }
    }
}

#[test]
fn contradictions_are_found() {
    let eigen = || protocol("eigen-80").unwrap();
    for wrong in [
        Protocol {
            name: "a b".to_owned(),
            ..eigen()
        },
        Protocol {
            max_depth_m: f64::NAN,
            ..eigen()
        },
        Protocol {
            disparity_floor_fraction: -0.1,
            ..eigen()
        },
        Protocol {
            crop: Crop::Pixels {
                rows: [45, 471],
                columns: [41, 41],
            },
            ..eigen()
        },
        Protocol {
            camera: Camera::Nominal { baseline_m: 0.54 },
            ..eigen()
        },
        Protocol {
            ground_truth: GroundTruthKind::Laser,
            ..eigen()
        },
        Protocol {
            d1_rule: Some(D1Rule::Strict),
            ..eigen()
        },
        Protocol {
            camera: Camera::Agreed {
                focal_fraction: 0.58,
                baseline_m: 0.0,
            },
            ..eigen()
        },
    ] {
        assert!(wrong.check().is_err(), "{wrong:?}");
    }
}

#[test]
fn yaml_round_trip_and_unknown_keys() {
    for known in protocols() {
        let text = serde_yaml::to_string(&known).unwrap();
        assert_eq!(serde_yaml::from_str::<Protocol>(&text).unwrap(), known);
        let more = format!("{text}crop_fraction: 1\n");
        assert!(serde_yaml::from_str::<Protocol>(&more).is_err());
    }
}

/// Every id of the Cityscapes table (PROTOCOL 1.3) and what has no group.
#[test]
fn label_ids_of_the_groups() {
    let ids = |group| {
        (0..=255)
            .filter(|&id| Group::of_label(id) == group)
            .collect::<Vec<u8>>()
    };
    assert_eq!(ids(Some(Group::Flat)), [7, 8, 9, 10]);
    assert_eq!(ids(Some(Group::Construction)), [11, 12, 13, 14, 15, 16]);
    assert_eq!(ids(Some(Group::Object)), [17, 18, 19, 20]);
    assert_eq!(ids(Some(Group::Human)), [24, 25]);
    assert_eq!(ids(Some(Group::Vehicle)), [26, 27, 28, 29, 30, 31, 32, 33]);
    assert_eq!(ids(None).len(), 256 - 24);
    for group in Group::all() {
        assert_eq!(group.to_string().parse(), Ok(group));
        assert_ne!(group.label_ids().is_some(), group.distance_m().is_some());
    }
    assert!("sky".parse::<Group>().is_err());
}

/// Each depth has one distance; bounds belong to the nearer group.
#[test]
fn distances_of_the_groups() {
    let bounds: Vec<(f64, f64)> = Group::DISTANCES
        .iter()
        .filter_map(|group| group.distance_m())
        .collect();
    assert!(bounds.windows(2).all(|pair| pair[0].1 == pair[1].0));
    for (depth_m, group) in [
        (1e-9, Some(Group::To5m)),
        (5.0, Some(Group::To5m)),
        (5.001, Some(Group::To10m)),
        (80.0, Some(Group::To80m)),
        (80.1, Some(Group::Over80m)),
        (0.0, None),
        (f64::NAN, None),
    ] {
        assert_eq!(Group::of_depth(depth_m), group, "{depth_m}");
    }
    for group in Group::DISTANCES {
        let (above, end) = group.distance_m().unwrap();
        let name = group.name();
        assert!(
            name == format!("{above}-{end}m") || name == format!("over-{above}m"),
            "{name}"
        );
    }
}

#[test]
fn words() {
    insta::assert_snapshot!(protocol("kitti2015").unwrap().describe(), @r#"
    Ground truth: KITTI stereo 2015 disparity, pixels visible in both images (disp_noc_0).
    Camera: focal length nominal for the image width, baseline 0.54 m for every image.
    Prediction: disparity of the left image resized bilinearly to the ground truth's size, then turned into depth.
    Crop: none.
    Pixels: all with ground truth, whatever their depth.
    Floor: disparities below 0.0001 of the width are raised to it and counted.
    Clip: predictions to 0.001 m .. 80 m.
    D1-all: percentage of pixels with an error of at least 3 px and at least 5 %.
    Average: unweighted mean over images.
    "#);
    insta::assert_snapshot!(protocol("eigen-50-median-pp").unwrap().describe(), @r#"
    Ground truth: Velodyne points in the left image, distance along the scanner's forward axis (about 0.3 m more than camera depth, as in all published rows).
    Camera: focal length and baseline of the image's own calibration.
    Prediction: disparity of the left image resized bilinearly to the ground truth's size, then turned into depth.
    Post-processing: blended with the prediction for the mirrored image.
    Crop: Garg, rows 0.40810811 to 0.99189189 of the height, columns 0.03594771 to 0.96405229 of the width, products truncated.
    Pixels: true depth strictly between 0.001 m and 50 m.
    Floor: disparities below 0.0001 of the width are raised to it and counted.
    Scale: each prediction is multiplied by median(true) / median(predicted).
    Clip: predictions to 0.001 m .. 50 m.
    Average: unweighted mean over images.
    "#);
    insta::assert_snapshot!(protocol("semantic").unwrap().describe(), @r#"
    Ground truth: KITTI stereo 2015 disparity, pixels visible in both images (disp_noc_0).
    Camera: focal length nominal for the image width, baseline 0.54 m for every image.
    Prediction: disparity of the left image resized bilinearly to the ground truth's size, then turned into depth.
    Crop: none.
    Pixels: all with ground truth, whatever their depth.
    Floor: disparities below 0.0001 of the width are raised to it and counted.
    Clip: predictions to 0.001 m .. 80 m.
    Groups: by Cityscapes label id: flat 7 to 10, human 24 to 25, vehicle 26 to 33, construction 11 to 16, object 17 to 20.
    Average: unweighted mean over images.
    "#);
}
