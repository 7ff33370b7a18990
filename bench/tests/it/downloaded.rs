//! From a downloaded file to a row: `bench describe` and the commands of the guide, tried with a stand-in of
//! the same signature as the file that they name.

use std::fs;

use image::{Rgb, RgbImage};
use strat_bench::model::{
    Description, Fit,
    draft::{FAMILIES, Family},
};
use strat_onnx::{metadata::OutputMeaning, proto::data_type};
use strat_splits::Split;
use strat_store::{image_files, yaml};

use crate::command::{Ran, bench, text};
use crate::fixtures::{HEIGHT, WIDTH, network};
use crate::input_forms::{Network, PLAIN};
use crate::world::World;

/// What the releases of Depth Anything take and give: 1 x 3 x H x W to 1 x H x W, both open.
const STAND_IN: Network<'_> = Network {
    rank: 3,
    names: ["pixel_values", "predicted_depth"],
    ..PLAIN
};

fn describe(world: &World, model: &str, more: &[&str]) -> Ran {
    let model = text(&world.path(model));
    let own = ["describe", &model, "--runtime", "embedded"];
    bench(&[&own, more].concat())
}

fn described(world: &World, yaml: &str) -> Description {
    yaml::load(&world.path(yaml)).unwrap()
}

/// Dark above, bright below: a network that sums colours calls the ground large.
fn street(world: &World) -> String {
    let image = RgbImage::from_fn(62, 40, |_, y| Rgb([(y * 6) as u8; 3]));
    let path = world.path("street.png");
    fs::write(&path, image_files::encode_png_rgb(&image)).unwrap();
    text(&path)
}

#[test]
fn the_three_commands_of_the_guide_end_in_a_row() {
    let world = World::new(Split::Eigen, 3, false);
    street(&world);
    fs::write(world.path("depth_anything_v2_vits.onnx"), STAND_IN.encode()).unwrap();
    let guide = include_str!("../../README.md");
    let (_, guide) = guide
        .split_once("## From a downloaded file to a row")
        .unwrap();
    let (_, fence) = guide.split_once("```sh\n").unwrap();
    let (fence, _) = fence.split_once("```").unwrap();
    let commands: Vec<&str> = fence.lines().collect();
    assert_eq!(commands.len(), 3, "{commands:?}");
    let mut ran = 0;
    for command in commands {
        let (program, rest) = command.split_once(' ').unwrap();
        if program == "prep" {
            // The fixture's set stands for the prepared one.
            continue;
        }
        let moved = |word: &str| match word {
            "sets/eigen" => text(&world.path("set")),
            "street.png" | "results/da2" | "depth_anything_v2_vits.onnx" => text(&world.path(word)),
            "da2=depth_anything_v2_vits.onnx" => {
                format!("da2={}", text(&world.path("depth_anything_v2_vits.onnx")))
            }
            word => word.to_owned(),
        };
        let words: Vec<String> = rest.split(' ').map(moved).collect();
        let mut words: Vec<&str> = words.iter().map(String::as_str).collect();
        words.extend(["--runtime", "embedded"]);
        let done = bench(&words);
        done.code(0);
        assert!(!done.err.contains("confirmed ("), "{}", done.err);
        ran += 1;
    }
    assert_eq!(ran, 2);
    let rows = world.rows("results/da2");
    assert!(!rows.is_empty() && rows.iter().all(|row| row.context.model == "da2"));
    let description = described(&world, "depth_anything_v2_vits.yaml");
    assert_eq!(description.input.name.as_deref(), Some("pixel_values"));
    assert_eq!(description.output.name.as_deref(), Some("predicted_depth"));
    assert_eq!(description.input.shorter_side, Some(518));
    assert!(description.output.align_corners);
}

#[test]
fn a_draft_says_what_was_read_and_what_is_to_be_confirmed() {
    let world = World::new(Split::Eigen, 1, false);
    fs::write(world.path("new.onnx"), STAND_IN.encode()).unwrap();
    let image = street(&world);
    let ran = describe(&world, "new.onnx", &["--image", &image]);
    ran.code(0)
        .says("lines are to be confirmed")
        .says("like inverse depth");
    let draft = fs::read_to_string(world.path("new.yaml")).unwrap();
    assert_eq!(ran.out, draft);
    let line = |start: &str| {
        draft
            .lines()
            .find(|line| line.trim().starts_with(start))
            .unwrap()
    };
    assert!(line("name: pixel_values").ends_with("# read from the file"));
    assert!(line("shorter_side:").contains("to be confirmed"));
    assert!(line("meaning: inverse_depth").contains("on street.png values are larger below"));
    assert!(line("# new.onnx: opset 17").contains("weights"));
    let description = described(&world, "new.yaml");
    assert_eq!(description.output.meaning, OutputMeaning::InverseDepth);

    // What is there is not replaced, and a draft in use is called one.
    describe(&world, "new.onnx", &[])
        .code(2)
        .says("is not replaced");
    assert_eq!(fs::read_to_string(world.path("new.yaml")).unwrap(), draft);
    let model = text(&world.path("new.onnx"));
    let evaluated = world.bench("3.3", "out", &["--model", &model]);
    evaluated.code(0).says("lines of its description");
}

#[test]
fn a_template_takes_its_size_and_names_from_the_file() {
    let world = World::new(Split::Eigen, 1, false);
    let square = Network {
        size: [56, 56],
        ..STAND_IN
    };
    fs::write(world.path("square.onnx"), square.encode()).unwrap();
    describe(&world, "square.onnx", &["--family", "depth-anything-v2"]).code(0);
    let description = described(&world, "square.yaml");
    assert_eq!(
        (description.input.width, description.input.height),
        (Some(56), Some(56))
    );
    assert_eq!(
        (description.input.fit, description.input.shorter_side),
        (Fit::Stretch, None)
    );
    let bytes = Network {
        element: data_type::UINT8,
        is_nhwc: true,
        size: [40, 62],
        ..PLAIN
    };
    fs::write(world.path("bytes.onnx"), bytes.encode()).unwrap();
    // The embedded runtime does not take bytes: the draft is written all the same.
    describe(&world, "bytes.onnx", &[])
        .code(1)
        .says("bench setup");
    let text = fs::read_to_string(world.path("bytes.yaml")).unwrap();
    assert!(
        text.contains("layout: nhwc") && text.contains("0..255"),
        "{text}"
    );
    assert!(!text.contains("mean:"), "{text}");
    described(&world, "bytes.yaml").check().unwrap();
}

#[test]
fn templates_are_printed_and_models_that_cannot_be_described_are_refused() {
    for Family { name, text } in FAMILIES {
        let printed = bench(&["describe", "--family", name]);
        printed.code(0);
        let direct: Description = serde_yaml::from_str(text).unwrap();
        let read: Description = serde_yaml::from_str(&printed.out).unwrap();
        assert_eq!(read, direct, "{name}");
    }
    let world = World::new(Split::Eigen, 1, false);
    bench(&["describe"]).code(2);
    bench(&["describe", "--family", "unheard-of"])
        .code(2)
        .says("depth-anything-v2");
    describe(&world, "none.onnx", &[]).code(1).says("none.onnx");
    fs::write(world.path("broken.onnx"), b"no model").unwrap();
    describe(&world, "broken.onnx", &[])
        .code(1)
        .says("broken.onnx");
    let camera = Network {
        second: Some(("intrinsics", &[1, 3, 3])),
        ..STAND_IN
    };
    fs::write(world.path("camera.onnx"), camera.encode()).unwrap();
    describe(&world, "camera.onnx", &[])
        .code(1)
        .says("intrinsics");
    // A model of `train` describes itself.
    let own = crate::fixtures::metadata("eigen");
    fs::write(world.path("own.onnx"), network(0.05, 0.0, Some(&own))).unwrap();
    describe(&world, "own.onnx", &[])
        .code(0)
        .says("describes itself");
    assert!(!world.path("own.yaml").exists());
    assert_eq!((WIDTH, HEIGHT), (124, 40));
}
