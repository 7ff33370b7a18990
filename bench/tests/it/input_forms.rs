//! What models want as input and how they give their maps, on networks whose answer numpy knows: each is a
//! weighted sum of the three channels, so its map says exactly which picture it was shown.

use std::path::{Path, PathBuf};

use image::{Rgb, RgbImage};
use prost::Message;
use prost::bytes::Bytes;
use strat_bench::{
    model::{Model, ModelError, mirror_input, prepare_input},
    runtime::{Device, Runtime, RuntimeChoice},
};
use strat_onnx::proto::{
    AttributeProto, Dimension, GraphProto, ModelProto, NodeProto, OperatorSetIdProto, TensorProto,
    TensorShapeProto, TypeProto, ValueInfoProto, attribute_type, data_type, dimension, type_proto,
};
use strat_store::raster::Plane;

use crate::fixtures::onnxruntime;

/// Weights of red, green and blue, and what is added.
const WEIGHTS: [f32; 3] = [0.5, 0.25, 0.125];
const BIAS: f32 = 0.5;

/// A network: the sum above, in whatever form.
#[derive(Clone, Copy)]
pub struct Network<'a> {
    /// Type of the input and of the output.
    pub element: i32,
    /// Height and width of the input; 0 is open.
    pub size: [i64; 2],
    pub is_nhwc: bool,
    /// Dimensions of the output: 4, 3 or 2.
    pub rank: usize,
    /// Names of the input and the output.
    pub names: [&'a str; 2],
    /// Name and dimensions of a second input.
    pub second: Option<(&'a str, &'a [i64])>,
}

pub const PLAIN: Network<'_> = Network {
    element: data_type::FLOAT,
    size: [0, 0],
    is_nhwc: false,
    rank: 4,
    names: ["image", "map"],
    second: None,
};

fn value_info(name: &str, element: i32, dims: Option<&[i64]>) -> ValueInfoProto {
    let dim = |(index, &size): (usize, &i64)| Dimension {
        value: Some(match size {
            0 => dimension::Value::DimParam(format!("d{index}")),
            size => dimension::Value::DimValue(size),
        }),
        ..Dimension::default()
    };
    let shape = dims.map(|dims| TensorShapeProto {
        dim: dims.iter().enumerate().map(dim).collect(),
    });
    ValueInfoProto {
        name: Some(name.to_owned()),
        r#type: Some(TypeProto {
            value: Some(type_proto::Value::TensorType(type_proto::Tensor {
                elem_type: Some(element),
                shape,
            })),
            ..TypeProto::default()
        }),
        ..ValueInfoProto::default()
    }
}

fn node(op: &str, inputs: &[&str], output: &str, attribute: Vec<AttributeProto>) -> NodeProto {
    let text = |name: &&str| (*name).to_owned();
    NodeProto {
        name: Some(format!("{op} {output}")),
        op_type: Some(op.to_owned()),
        input: inputs.iter().map(text).collect(),
        output: vec![output.to_owned()],
        attribute,
        ..NodeProto::default()
    }
}

fn constant(name: &str, element: i32, dims: &[i64], bytes: Vec<u8>) -> TensorProto {
    TensorProto {
        name: Some(name.to_owned()),
        data_type: Some(element),
        dims: dims.to_vec(),
        raw_data: Some(Bytes::from(bytes)),
        ..TensorProto::default()
    }
}

fn attribute(name: &str, kind: i32) -> AttributeProto {
    AttributeProto {
        name: Some(name.to_owned()),
        r#type: Some(kind),
        ..AttributeProto::default()
    }
}

fn cast(to: i32) -> Vec<AttributeProto> {
    vec![AttributeProto {
        i: Some(to.into()),
        ..attribute("to", attribute_type::INT)
    }]
}

impl Network<'_> {
    pub fn encode(&self) -> Vec<u8> {
        let [height, width] = self.size;
        let [input, output] = self.names;
        let dims = match self.is_nhwc {
            true => [1, height, width, 3],
            false => [1, 3, height, width],
        };
        let mut nodes = Vec::new();
        let mut last = input;
        if self.element != data_type::FLOAT {
            nodes.push(node("Cast", &[last], "floats", cast(data_type::FLOAT)));
            last = "floats";
        }
        if self.is_nhwc {
            let order = AttributeProto {
                ints: vec![0, 3, 1, 2],
                ..attribute("perm", attribute_type::INTS)
            };
            nodes.push(node("Transpose", &[last], "channels", vec![order]));
            last = "channels";
        }
        let kernel = AttributeProto {
            ints: vec![1, 1],
            ..attribute("kernel_shape", attribute_type::INTS)
        };
        nodes.push(node(
            "Conv",
            &[last, "weights", "bias"],
            "sum",
            vec![kernel],
        ));
        last = "sum";
        if self.rank < 4 {
            nodes.push(node("Squeeze", &[last, "axes"], "squeezed", Vec::new()));
            last = "squeezed";
        }
        nodes.push(match self.element {
            data_type::FLOAT => node("Relu", &[last], output, Vec::new()),
            element => node("Cast", &[last], output, cast(element)),
        });
        let floats = |values: &[f32]| values.iter().flat_map(|v| v.to_le_bytes()).collect();
        let axes: Vec<i64> = match self.rank {
            3 => vec![1],
            _ => vec![0, 1],
        };
        let mut inputs = vec![value_info(input, self.element, Some(&dims))];
        let second = self.second;
        inputs.extend(second.map(|(name, dims)| value_info(name, data_type::FLOAT, Some(dims))));
        let graph = GraphProto {
            name: Some("a sum of channels".to_owned()),
            input: inputs,
            output: vec![value_info(output, self.element, None)],
            initializer: vec![
                constant("weights", data_type::FLOAT, &[1, 3, 1, 1], floats(&WEIGHTS)),
                constant("bias", data_type::FLOAT, &[1], floats(&[BIAS])),
                constant(
                    "axes",
                    data_type::INT64,
                    &[axes.len() as i64],
                    axes.iter().flat_map(|axis| axis.to_le_bytes()).collect(),
                ),
            ],
            node: nodes,
            ..GraphProto::default()
        };
        let model = ModelProto {
            ir_version: Some(8),
            opset_import: vec![OperatorSetIdProto {
                domain: None,
                version: Some(17),
            }],
            graph: Some(graph),
            ..ModelProto::default()
        };
        model.encode_to_vec()
    }

    /// Writes it with a description beside it.
    pub fn write(&self, folder: &Path, name: &str, description: &str) -> PathBuf {
        let path = folder.join(format!("{name}.onnx"));
        std::fs::write(&path, self.encode()).unwrap();
        std::fs::write(path.with_extension("yaml"), description).unwrap();
        path
    }
}

/// (31 x + 17 y + 71 c + 3 (x y mod 97)) mod 256
fn picture(width: u32, height: u32) -> RgbImage {
    RgbImage::from_fn(width, height, |x, y| {
        Rgb([0, 1, 2].map(|c| ((31 * x + 17 * y + 71 * c + x * y % 97 * 3) % 256) as u8))
    })
}

/// As the model is asked by every command, brought to the size of the image as maps are scored.
fn map(model: &mut Model, image: &RgbImage, focal_px: Option<f64>) -> Result<Plane, ModelError> {
    let input = prepare_input(image, &model.description.input, focal_px)?;
    let map = model.predict(&input)?;
    let (width, height) = (image.width() as usize, image.height() as usize);
    Ok(strat_store::resize::bilinear_f32(&map, width, height))
}

fn runtimes() -> Vec<Runtime> {
    let mut choices = vec![RuntimeChoice::Embedded];
    choices.extend(onnxruntime().map(|_| RuntimeChoice::Ort));
    let resolve = |choice| Runtime::resolve(choice, Device::Cpu).unwrap().0;
    choices.into_iter().map(resolve).collect()
}

const IMAGENET: &str = "mean: [0.485, 0.456, 0.406], std: [0.229, 0.224, 0.225]";

/// Name, network, input and output of its description, image, and what numpy makes of it.
type Form<'a> = (
    &'a str,
    Network<'a>,
    String,
    &'a str,
    &'a RgbImage,
    [f64; 3],
);

#[test]
fn every_form_gives_the_map_that_numpy_computes() {
    let folder = tempfile::tempdir().unwrap();
    let small = picture(31, 18);
    let kitti = picture(1242, 375);
    let relative = "{meaning: inverse_depth}";
    // Recipe: make_golden.py bench/input-forms: the sum of each map, and its values in row 2, column 3 and
    // in the last pixel.
    let forms: [Form<'_>; 10] = [
        ("fixed", Network { size: [12, 16], ..PLAIN }, "range: 0..1, width: 16, height: 12, kernel: opencv-linear".to_owned(), relative, &small, [522.695137571, 1.014032522, 0.826470588]),
        ("channels last", Network { is_nhwc: true, size: [12, 16], ..PLAIN }, "range: 0..255, width: 16, height: 12, kernel: bilinear, layout: nhwc".to_owned(), relative, &small, [62421.260080645, 131.578293011, 83.75]),
        ("half", Network { element: data_type::FLOAT16, rank: 3, ..PLAIN }, "range: 0..1, width: 16, height: 12, kernel: opencv-linear".to_owned(), relative, &small, [522.695137571, 1.014032522, 0.826470588]),
        ("bytes", Network { element: data_type::UINT8, rank: 2, ..PLAIN }, "range: 0..255, width: 16, height: 12, kernel: bilinear".to_owned(), relative, &small, [62164.427419355, 131.158602151, 83.0]),
        ("dynamic", Network { rank: 3, ..PLAIN }, format!("range: 0..1, {IMAGENET}, fit: keep-aspect, shorter_side: 14, multiple_of: 7, kernel: opencv-cubic"), "{meaning: inverse_depth, align_corners: true}", &small, [363.617724711, 1.107524684, 0.0]),
        ("dynamic, edges", Network { rank: 2, ..PLAIN }, format!("range: 0..1, {IMAGENET}, fit: keep-aspect, shorter_side: 14, multiple_of: 7, kernel: opencv-cubic"), relative, &small, [363.047523495, 1.017634361, 0.0]),
        ("dynamic, cubic", Network { ..PLAIN }, format!("range: 0..1, {IMAGENET}, fit: keep-aspect, shorter_side: 14, multiple_of: 7, kernel: opencv-cubic"), "{meaning: inverse_depth, kernel: opencv-cubic}", &small, [362.642371783, 1.083002055, -0.113790302]),
        ("crop", Network { ..PLAIN }, "range: 0..1, width: 76, height: 22, crop: kitti-benchmark".to_owned(), relative, &kitti, [401301.960784314, 0.0, 0.0]),
        ("canonical", Network { ..PLAIN }, "range: 0..1, width: 16, height: 12, kernel: opencv-linear".to_owned(), "{meaning: depth_m, canonical_focal_px: 1000}", &small, [194.644924778, 0.377612627, 0.307766983]),
        ("padded", Network { ..PLAIN }, "range: 0..1, fit: keep-aspect, width: 20, height: 16, pad: [200, 100, 50], kernel: bilinear".to_owned(), relative, &small, [519.938875053, 1.038294372, 0.807352941]),
    ];
    for runtime in runtimes() {
        let is_embedded = runtime.library().is_none();
        for (name, network, input, output, image, expected) in &forms {
            let description = format!("input: {{{input}}}\noutput: {output}\n");
            let path = network.write(folder.path(), name, &description);
            let opened = Model::open(name, &path, &runtime, Device::Cpu, 1);
            if is_embedded && network.element != data_type::FLOAT {
                let error = opened.unwrap_err().to_string();
                assert!(error.contains("bench setup"), "{name}: {error}");
                continue;
            }
            let mut model = opened.unwrap();
            let found = map(&mut model, image, Some(721.5)).unwrap();
            let width = image.width() as usize;
            assert_eq!(
                (found.width, found.height),
                (width, image.height() as usize)
            );
            let sum: f64 = found.data.iter().map(|value| f64::from(*value)).sum();
            let last = found.data.len() - 1;
            let found = [
                sum,
                found.data[2 * width + 3].into(),
                found.data[last].into(),
            ];
            // Half precision has eleven bits; sums of pictures are rounded otherwise in `f32`.
            let tolerance = if network.element == data_type::FLOAT16 {
                1e-3
            } else {
                2e-5
            };
            for (found, expected) in found.iter().zip(expected) {
                let difference = (found - expected).abs();
                assert!(
                    difference <= tolerance * expected.abs().max(1.0),
                    "{runtime}, {name}: {found} is not {expected}"
                );
            }
        }
    }
}

/// The mirrored image's map, mirrored, is the image's own: with padding and a crop that are not in the
/// middle too.
#[test]
fn mirrored_inputs_are_those_of_mirrored_images() {
    let folder = tempfile::tempdir().unwrap();
    let description = "input: {range: 0..1, fit: keep-aspect, width: 12, height: 9, kernel: bilinear, \
                       crop: !pixels {rows: [1, 8], columns: [2, 12]}}\noutput: {meaning: inverse_depth}\n";
    let path = PLAIN.write(folder.path(), "mirror", description);
    let (runtime, _) = Runtime::resolve(RuntimeChoice::Embedded, Device::Cpu).unwrap();
    let mut model = Model::open("mirror", &path, &runtime, Device::Cpu, 1).unwrap();
    let image = picture(17, 9);
    let plain = map(&mut model, &image, None).unwrap();
    let input = model.description.input.clone();
    let mut prepared = prepare_input(&image, &input, None).unwrap();
    mirror_input(&mut prepared, &input);
    let mut mirrored = model.predict(&prepared).unwrap();
    mirrored
        .data
        .chunks_exact_mut(17)
        .for_each(<[f32]>::reverse);
    for (a, b) in plain.data.iter().zip(&mirrored.data) {
        assert!((a - b).abs() < 1e-6, "{a} {b}");
    }
}

#[test]
fn what_a_model_cannot_be_asked_is_refused_in_a_sentence() {
    let folder = tempfile::tempdir().unwrap();
    let (runtime, _) = Runtime::resolve(RuntimeChoice::Embedded, Device::Cpu).unwrap();
    let refused = |network: Network<'_>, description: &str| {
        let path = network.write(folder.path(), "refused", description);
        let opened = Model::open("refused", &path, &runtime, Device::Cpu, 1);
        opened.unwrap_err().to_string()
    };
    let fixed = "input: {range: 0..1, width: 28, height: 14}\noutput: {meaning: depth_m}\n";
    let camera = Network {
        second: Some(("intrinsics", &[1, 3, 3])),
        ..PLAIN
    };
    let error = refused(camera, fixed);
    assert!(
        error.contains("`intrinsics` f32 [1, 3, 3]") && error.contains("--predictions"),
        "{error}"
    );
    let square = Network {
        size: [518, 518],
        ..PLAIN
    };
    let dynamic = "input: {range: 0..1, fit: keep-aspect, shorter_side: 518, multiple_of: 14}\n\
                   output: {meaning: inverse_depth}\n";
    let error = refused(square, dynamic);
    assert!(
        error.contains("fixed shape") && error.contains("`width`"),
        "{error}"
    );
    let bytes = Network {
        element: data_type::UINT8,
        ..PLAIN
    };
    let error = refused(bytes, fixed);
    assert!(error.contains("`range: 0..255`"), "{error}");

    // What depends on the image is said of the image.
    let kitti = "input: {range: 0..1, width: 28, height: 14, crop: kitti-benchmark}\n\
                 output: {meaning: depth_m, canonical_focal_px: 1000}\n";
    let path = PLAIN.write(folder.path(), "kitti", kitti);
    let mut model = Model::open("kitti", &path, &runtime, Device::Cpu, 1).unwrap();
    let error = map(&mut model, &picture(640, 480), Some(500.0)).unwrap_err();
    assert!(error.to_string().contains("640x480"), "{error}");
    let error = map(&mut model, &picture(1242, 375), None).unwrap_err();
    assert!(
        error.to_string().contains("`canonical_focal_px`"),
        "{error}"
    );
}
