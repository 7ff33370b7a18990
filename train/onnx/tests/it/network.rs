//! Every operator of the builder, written, read back, run by the embedded runtime and compared
//! with direct loops over the definition.

use strat_onnx::embedded::EmbeddedSession;
use strat_onnx::graph::{Dim, Filter, Geometry, GraphBuilder, GraphError, OPSET, Value};
use strat_onnx::metadata::{InputRange, ModelMetadata, OutputMeaning, Probe, probe_image};
use strat_onnx::model;

/// A batch of images, row-major `[n, c, h, w]`.
#[derive(Clone)]
struct Images {
    shape: [usize; 4],
    data: Vec<f32>,
}

impl Images {
    fn zeros(shape: [usize; 4]) -> Self {
        Self {
            shape,
            data: vec![0.0; shape.iter().product()],
        }
    }

    fn index(&self, [n, c, y, x]: [usize; 4]) -> usize {
        let [_, channels, height, width] = self.shape;
        ((n * channels + c) * height + y) * width + x
    }

    /// The element, or `outside` where the position lies beside the image.
    fn get(&self, n: usize, c: usize, y: isize, x: isize, outside: f32) -> f32 {
        let [_, _, height, width] = self.shape.map(|size| size as isize);
        if y < 0 || x < 0 || y >= height || x >= width {
            return outside;
        }
        self.data[self.index([n, c, y as usize, x as usize])]
    }

    fn map(&self, f: impl Fn(f32) -> f32) -> Self {
        Self {
            shape: self.shape,
            data: self.data.iter().map(|&v| f(v)).collect(),
        }
    }

    /// Fills a result of the given shape from `f(n, c, y, x)`.
    fn generate(shape: [usize; 4], f: impl Fn(usize, usize, isize, isize) -> f32) -> Self {
        let mut result = Self::zeros(shape);
        for n in 0..shape[0] {
            for c in 0..shape[1] {
                for y in 0..shape[2] {
                    for x in 0..shape[3] {
                        let at = result.index([n, c, y, x]);
                        result.data[at] = f(n, c, y as isize, x as isize);
                    }
                }
            }
        }
        result
    }
}

/// Values in -0.5..0.5 without pattern at the sizes used here: multiples of 37 modulo 101.
fn numbers(count: usize, offset: usize) -> Vec<f32> {
    (0..count)
        .map(|i| ((i + offset) * 37 % 101) as f32 / 101.0 - 0.5)
        .collect()
}

fn filter(shape: [usize; 4], bias: usize, offset: usize) -> Filter {
    Filter {
        shape,
        weights: numbers(shape.iter().product(), offset),
        bias: numbers(bias, offset + 13),
    }
}

fn weight(filter: &Filter, [a, b, y, x]: [usize; 4]) -> f32 {
    let [_, second, height, width] = filter.shape;
    filter.weights[((a * second + b) * height + y) * width + x]
}

fn bias(filter: &Filter, channel: usize) -> f64 {
    filter.bias.get(channel).map_or(0.0, |&b| f64::from(b))
}

fn conv(input: &Images, filter: &Filter, geometry: Geometry) -> Images {
    let [n, _, height, width] = input.shape;
    let [out, per_group, kernel_h, kernel_w] = filter.shape;
    let size = |size: usize, axis: usize, kernel: usize| {
        (size + geometry.pads[axis] + geometry.pads[axis + 2]
            - geometry.dilation[axis] * (kernel - 1)
            - 1)
            / geometry.stride[axis]
            + 1
    };
    let shape = [n, out, size(height, 0, kernel_h), size(width, 1, kernel_w)];
    Images::generate(shape, |n, o, y, x| {
        let group = o / (out / geometry.group);
        let mut sum = bias(filter, o);
        for i in 0..per_group {
            for ky in 0..kernel_h {
                for kx in 0..kernel_w {
                    let at = |out: isize, axis: usize, k: usize| {
                        out * geometry.stride[axis] as isize
                            + (k * geometry.dilation[axis]) as isize
                            - geometry.pads[axis] as isize
                    };
                    let value =
                        input.get(n, group * per_group + i, at(y, 0, ky), at(x, 1, kx), 0.0);
                    sum += f64::from(value) * f64::from(weight(filter, [o, i, ky, kx]));
                }
            }
        }
        sum as f32
    })
}

/// By its definition: every input pixel adds the kernel, scaled, to the result.
fn conv_transpose(input: &Images, filter: &Filter, geometry: Geometry) -> Images {
    let [batch, channels, height, width] = input.shape;
    let [_, out, kernel_h, kernel_w] = filter.shape;
    let size = |size: usize, axis: usize, kernel: usize| {
        (size - 1) * geometry.stride[axis] + kernel - geometry.pads[axis] - geometry.pads[axis + 2]
    };
    let mut result = Images::generate(
        [
            batch,
            out,
            size(height, 0, kernel_h),
            size(width, 1, kernel_w),
        ],
        |_, c, _, _| bias(filter, c) as f32,
    );
    for n in 0..batch {
        for i in 0..channels {
            for y in 0..height {
                for x in 0..width {
                    let value = input.data[input.index([n, i, y, x])];
                    for o in 0..out {
                        for ky in 0..kernel_h {
                            for kx in 0..kernel_w {
                                let row =
                                    (y * geometry.stride[0] + ky).checked_sub(geometry.pads[0]);
                                let col =
                                    (x * geometry.stride[1] + kx).checked_sub(geometry.pads[1]);
                                let (Some(row), Some(col)) = (row, col) else {
                                    continue;
                                };
                                if row < result.shape[2] && col < result.shape[3] {
                                    let at = result.index([n, o, row, col]);
                                    result.data[at] += value * weight(filter, [i, o, ky, kx]);
                                }
                            }
                        }
                    }
                }
            }
        }
    }
    result
}

fn max_pool(input: &Images, kernel: usize, stride: usize, pad: usize) -> Images {
    let [n, c, height, width] = input.shape;
    let size = |size: usize| (size + 2 * pad - kernel) / stride + 1;
    Images::generate([n, c, size(height), size(width)], |n, c, y, x| {
        let mut largest = f32::NEG_INFINITY;
        for ky in 0..kernel {
            for kx in 0..kernel {
                let at = |out: isize, k: usize| out * stride as isize + k as isize - pad as isize;
                largest = largest.max(input.get(n, c, at(y, ky), at(x, kx), f32::NEG_INFINITY));
            }
        }
        largest
    })
}

fn concat_channels(a: &Images, b: &Images) -> Images {
    let [n, channels, height, width] = a.shape;
    Images::generate([n, channels + b.shape[1], height, width], |n, c, y, x| {
        if c < channels {
            a.get(n, c, y, x, 0.0)
        } else {
            b.get(n, c - channels, y, x, 0.0)
        }
    })
}

fn elu(x: f32) -> f32 {
    if x > 0.0 {
        x
    } else {
        f64::from(x).exp_m1() as f32
    }
}

/// Mean 0 and variance 1 within each channel of each sample, epsilon 1e-5, then scale and shift.
fn instance_norm(input: &Images, scale: [f32; 4], shift: [f32; 4]) -> Images {
    let [_, channels, height, width] = input.shape;
    let plane = height * width;
    let mut output = input.clone();
    for (index, values) in output.data.chunks_mut(plane).enumerate() {
        let count = plane as f64;
        let mean = values.iter().map(|&v| f64::from(v)).sum::<f64>() / count;
        let squares = values.iter().map(|&v| (f64::from(v) - mean).powi(2));
        let deviation = (squares.sum::<f64>() / count + 1e-5).sqrt();
        let channel = index % channels;
        for value in values {
            let normal = (f64::from(*value) - mean) / deviation;
            *value = (normal * f64::from(scale[channel]) + f64::from(shift[channel])) as f32;
        }
    }
    output
}

fn sigmoid(x: f32) -> f32 {
    (1.0 / (1.0 + (-f64::from(x)).exp())) as f32
}

/// Builds a graph whose every layer is an output, and the same by direct loops.
struct Twin {
    graph: GraphBuilder,
    expected: Vec<(String, Images)>,
}

impl Twin {
    fn keep(&mut self, name: &str, value: Value, images: Images) -> (Value, Images) {
        let dims: Vec<Option<usize>> = self.graph.dims(value).iter().map(Dim::fixed).collect();
        let found: Vec<Option<usize>> = images.shape.iter().copied().map(Some).collect();
        assert_eq!(dims[1..], found[1..], "inferred shape of {name}");
        self.graph.output(&format!("{name}_out"), value).unwrap();
        self.expected.push((format!("{name}_out"), images.clone()));
        (value, images)
    }
}

/// A batch of two images of 3 x 8 x 12 through every operator; returns the file, the input and
/// what every layer must give.
fn all_operators() -> (Vec<u8>, Images, Vec<(String, Images)>) {
    let image = Images {
        shape: [2, 3, 8, 12],
        data: numbers(2 * 3 * 8 * 12, 5).iter().map(|v| v * 4.0).collect(),
    };
    let mut twin = Twin {
        graph: GraphBuilder::new("all operators"),
        expected: Vec::new(),
    };
    let dims = ["batch".into(), 3.into(), 8.into(), 12.into()];
    let input = twin.graph.input("image", &dims).unwrap();

    let geometry = Geometry::new(2, 3);
    let f = filter([4, 3, 7, 7], 4, 1);
    let x = twin.graph.conv("stem", input, f.clone(), geometry).unwrap();
    let (stem, stem_ref) = twin.keep("stem", x, conv(&image, &f, geometry));

    let x = twin.graph.elu("stem_elu", stem).unwrap();
    let (act, act_ref) = twin.keep("stem_elu", x, stem_ref.map(elu));

    let geometry = Geometry::new(2, 1);
    let x = twin.graph.max_pool("pool", act, 3, geometry).unwrap();
    let (pool, pool_ref) = twin.keep("pool", x, max_pool(&act_ref, 3, 2, 1));

    let x = twin.graph.pad_zero("pad", act, [1, 0, 2, 1]).unwrap();
    let [n, c, h, w] = act_ref.shape;
    let padded = Images::generate([n, c, h + 3, w + 1], |n, c, y, x| {
        act_ref.get(n, c, y - 1, x, 0.0)
    });
    twin.keep("pad", x, padded);

    let geometry = Geometry::new(2, 1);
    let f = filter([4, 5, 4, 4], 5, 2);
    let x = twin
        .graph
        .conv_transpose("up", pool, f.clone(), geometry)
        .unwrap();
    let (up, up_ref) = twin.keep("up", x, conv_transpose(&pool_ref, &f, geometry));

    let x = twin.graph.concat("skip", &[up, act], 1).unwrap();
    let (skip, skip_ref) = twin.keep("skip", x, concat_channels(&up_ref, &act_ref));

    let f = filter([4, 9, 1, 1], 0, 3);
    let geometry = Geometry::new(1, 0);
    let x = twin
        .graph
        .conv("project", skip, f.clone(), geometry)
        .unwrap();
    let (project, project_ref) = twin.keep("project", x, conv(&skip_ref, &f, geometry));

    let x = twin.graph.add("sum", project, act).unwrap();
    let mut sum_ref = project_ref.clone();
    sum_ref
        .data
        .iter_mut()
        .zip(&act_ref.data)
        .for_each(|(a, b)| *a += b);
    let (sum, sum_ref) = twin.keep("sum", x, sum_ref);

    let x = twin.graph.relu("relu", sum).unwrap();
    let (relu, relu_ref) = twin.keep("relu", x, sum_ref.map(|v| v.max(0.0)));

    let geometry = Geometry {
        stride: [1, 2],
        pads: [2, 0, 1, 1],
        dilation: [2, 1],
        group: 2,
    };
    let f = filter([6, 2, 3, 2], 6, 4);
    let x = twin
        .graph
        .conv("uneven", relu, f.clone(), geometry)
        .unwrap();
    twin.keep("uneven", x, conv(&relu_ref, &f, geometry));

    let x = twin.graph.nearest_x2("double", relu).unwrap();
    let [n, c, h, w] = relu_ref.shape;
    let doubled = Images::generate([n, c, 2 * h, 2 * w], |n, c, y, x| {
        relu_ref.get(n, c, y / 2, x / 2, 0.0)
    });
    let (double, double_ref) = twin.keep("double", x, doubled);
    twin.graph.nearest_x2("again", double).unwrap();

    let f = filter([2, 4, 3, 3], 2, 6);
    let geometry = Geometry::new(1, 1);
    let x = twin
        .graph
        .conv("head", double, f.clone(), geometry)
        .unwrap();
    let (head, head_ref) = twin.keep("head", x, conv(&double_ref, &f, geometry));
    let x = twin.graph.sigmoid("head_sigmoid", head).unwrap();
    let (head, head_ref) = twin.keep("head_sigmoid", x, head_ref.map(sigmoid));
    let x = twin.graph.scale("head_scale", head, 0.3).unwrap();
    twin.keep("head_scale", x, head_ref.map(|v| v * 0.3));

    let (scale, shift) = ([1.5, -0.5, 0.0, 2.0], [0.25, 0.0, -1.0, 1.0]);
    let x = twin
        .graph
        .instance_norm("norm", project, [&scale, &shift], 1e-5)
        .unwrap();
    let (norm, norm_ref) = twin.keep("norm", x, instance_norm(&project_ref, scale, shift));
    let x = twin.graph.leaky_relu("leaky", norm, 0.2).unwrap();
    let leaky = |v: f32| if v < 0.0 { 0.2 * v } else { v };
    twin.keep("leaky", x, norm_ref.map(leaky));

    let mut metadata =
        ModelMetadata::new(OutputMeaning::DisparityFraction, InputRange::Unit, 12, 8);
    metadata.tool_version = Some("0.0.0-test".into());
    let bytes = twin.graph.finish(Some(&metadata)).unwrap();
    (bytes, image, twin.expected)
}

#[test]
fn every_operator_agrees_with_direct_loops() {
    let (bytes, image, expected) = all_operators();
    // For a look with other tools: `STRAT_ONNX_DUMP=folder` keeps the file and its values.
    if let Some(folder) = std::env::var_os("STRAT_ONNX_DUMP").map(std::path::PathBuf::from) {
        let save = |name: &str, data: &[f32]| {
            let bytes: Vec<u8> = data.iter().flat_map(|v| v.to_le_bytes()).collect();
            std::fs::write(folder.join(name), bytes).unwrap();
        };
        std::fs::write(folder.join("all_operators.onnx"), &bytes).unwrap();
        save("image.f32", &image.data);
        for (name, images) in &expected {
            save(&format!("{name}.f32"), &images.data);
        }
    }
    for threads in [Some(1), None] {
        let session = EmbeddedSession::from_bytes(bytes.clone(), "test", threads).unwrap();
        let found = session.run("image", &image.shape, &image.data).unwrap();
        assert_eq!(found.len(), expected.len());
        for ((name, shape, data), (expected_name, expected)) in found.iter().zip(&expected) {
            assert_eq!(name, expected_name);
            assert_eq!(shape[..], expected.shape, "{name}");
            let scale = expected.data.iter().fold(1.0_f32, |a, v| a.max(v.abs()));
            for (index, (a, b)) in data.iter().zip(&expected.data).enumerate() {
                assert!(
                    (a - b).abs() <= 1e-6 * scale,
                    "{name}[{index}]: {a} instead of {b}"
                );
            }
        }
    }
}

#[test]
fn the_file_describes_itself() {
    let (bytes, _, expected) = all_operators();
    let info = model::inspect(&bytes, "test").unwrap();
    assert_eq!((info.opset, info.ir_version), (Some(OPSET), 8));
    assert_eq!(info.producer.as_deref(), Some("strat"));
    assert_eq!(info.producer_version.as_deref(), Some("0.0.0-test"));
    assert_eq!(info.inputs.len(), 1);
    assert_eq!(
        info.inputs[0].dims.as_deref().unwrap(),
        [Dim::from("batch"), 3.into(), 8.into(), 12.into()]
    );
    assert_eq!(info.outputs.len(), expected.len());
    assert_eq!(info.operators["Conv"], 4);
    assert_eq!(info.operators["ConvTranspose"], 1);
    // stem, up, project, uneven, head; pad amounts and value; resize scales; scale factor; norm.
    let weights = (588 + 4) + (320 + 5) + 36 + (72 + 6) + (72 + 2);
    assert_eq!(info.parameters, weights + 8 + 1 + 4 + 1 + 8);
    assert_eq!(info.description.problems, Vec::<String>::new());
    assert_eq!(info.metadata().unwrap().input_width, 12);
}

#[test]
fn building_is_reproducible() {
    assert_eq!(all_operators().0, all_operators().0);
}

/// By hand: a 4 x 4 kernel of ones with stride 2 and padding 1 spreads pixel `p` over rows and
/// columns `2p - 1 ..= 2p + 2`, so of two pixels 1 and 10 in a row the four columns get
/// 1, 1 + 10, 1 + 10, 10 (columns 0..=2 from the first, 1..=3 from the second), in both rows.
#[test]
fn transposed_convolution_by_hand() {
    let mut graph = GraphBuilder::new("up");
    let input = graph
        .input("x", &[1.into(), 1.into(), 1.into(), 2.into()])
        .unwrap();
    let ones = Filter {
        shape: [1, 1, 4, 4],
        weights: vec![1.0; 16],
        bias: vec![],
    };
    let up = graph
        .conv_transpose("up", input, ones, Geometry::new(2, 1))
        .unwrap();
    graph.output("y", up).unwrap();
    let session = EmbeddedSession::from_bytes(graph.finish(None).unwrap(), "up", Some(1)).unwrap();
    let found = session.run("x", &[1, 1, 1, 2], &[1.0, 10.0]).unwrap();
    let row = [1.0, 11.0, 11.0, 10.0];
    assert_eq!(
        found,
        [("y".to_owned(), vec![1, 1, 2, 4], [row, row].concat())]
    );
}

/// By hand: padding never wins a maximum, even when all values are negative.
#[test]
fn pooling_ignores_its_padding() {
    let mut graph = GraphBuilder::new("pool");
    let input = graph
        .input("x", &[1.into(), 1.into(), 2.into(), 2.into()])
        .unwrap();
    let pool = graph
        .max_pool("pool", input, 3, Geometry::new(2, 1))
        .unwrap();
    graph.output("y", pool).unwrap();
    let session = EmbeddedSession::from_bytes(graph.finish(None).unwrap(), "p", Some(1)).unwrap();
    let found = session
        .run("x", &[1, 1, 2, 2], &[-4.0, -3.0, -2.0, -5.0])
        .unwrap();
    assert_eq!(found[0].2, [-2.0]);
}

#[test]
fn dynamic_sizes_run_at_several_sizes() {
    let mut graph = GraphBuilder::new("dynamic");
    let dims = ["N".into(), 1.into(), "H".into(), "W".into()];
    let input = graph.input("x", &dims).unwrap();
    let half = graph
        .max_pool("half", input, 2, Geometry::new(2, 0))
        .unwrap();
    assert_eq!(graph.dims(half)[2], Dim::Unknown);
    let full = graph.nearest_x2("full", half).unwrap();
    let sum = graph.add("sum", full, input).unwrap();
    assert_eq!(graph.dims(sum), dims);
    graph.output_with_dims("y", sum, &dims).unwrap();
    let session = EmbeddedSession::from_bytes(graph.finish(None).unwrap(), "d", Some(1)).unwrap();
    for (height, width) in [(2, 2), (4, 6)] {
        let data = vec![0.5; 2 * height * width];
        let found = session.run("x", &[2, 1, height, width], &data).unwrap();
        assert_eq!(found[0].1, [2, 1, height, width]);
        assert!(found[0].2.iter().all(|&v| v == 1.0));
    }
}

#[test]
fn wrong_layers_are_refused_where_they_are_added() {
    let mut graph = GraphBuilder::new("wrong");
    let input = graph
        .input("x", &["N".into(), 3.into(), 8.into(), 8.into()])
        .unwrap();
    let text = |result: Result<Value, GraphError>| result.unwrap_err().to_string();

    let f = filter([4, 2, 3, 3], 4, 0);
    let message = text(graph.conv("a", input, f, Geometry::new(1, 1)));
    assert_eq!(
        message,
        "layer \"a\": the filter is for 2 channels, its input has 3"
    );
    let mut f = filter([4, 3, 3, 3], 4, 0);
    f.weights.pop();
    assert!(text(graph.conv("a", input, f, Geometry::new(1, 1))).contains("needs 108 weights"));
    let f = filter([4, 3, 3, 3], 3, 0);
    assert!(text(graph.conv("a", input, f, Geometry::new(1, 1))).contains("biases"));
    let f = filter([4, 3, 9, 9], 4, 0);
    assert!(text(graph.conv("a", input, f, Geometry::new(1, 0))).contains("does not fit"));
    let f = filter([4, 3, 3, 3], 4, 0);
    let zero = Geometry {
        stride: [0, 1],
        ..Geometry::new(1, 1)
    };
    assert!(text(graph.conv("a", input, f.clone(), zero)).contains("stride"));
    assert!(text(graph.conv_transpose("a", input, f, Geometry::new(2, 1))).contains("channels"));

    let three = [1.0; 3];
    let message = text(graph.instance_norm("a", input, [&three, &three[..2]], 1e-5));
    assert!(
        message.contains("3 channels need as many scales"),
        "{message}"
    );
    let f = filter([3, 3, 3, 3], 3, 0);
    let small = graph.conv("b", input, f, Geometry::new(2, 1)).unwrap();
    assert!(text(graph.add("c", input, small)).contains("cannot be added"));
    assert!(text(graph.concat("c", &[input, small], 1)).contains("cannot be joined"));
    assert!(text(graph.concat("c", &[], 1)).contains("nothing"));
    assert!(text(graph.concat("c", &[input], 4)).contains("no axis 4"));
    let taken = Err(GraphError::DuplicateName { name: "b".into() });
    assert_eq!(graph.relu("b", input), taken);
    assert_eq!(graph.relu("", input), Err(GraphError::EmptyName));
    assert_eq!(
        graph
            .relu("b.weight", input)
            .unwrap_err()
            .to_string()
            .matches("twice")
            .count(),
        1
    );

    assert!(graph.output("y", input).is_err(), "an input is no output");
    assert!(
        graph
            .output_with_dims("y", small, &["N".into(), 3.into(), 5.into(), 4.into()])
            .is_err()
    );
    graph.output("y", small).unwrap();
    assert!(graph.output("z", small).is_err(), "a value is one output");
    let empty = GraphBuilder::new("empty");
    assert_eq!(
        empty.finish(None),
        Err(GraphError::Missing { what: "input" })
    );
}

#[test]
fn wrong_inputs_are_sentences() {
    let (bytes, image, _) = all_operators();
    let session = EmbeddedSession::from_bytes(bytes, "net.onnx", Some(1)).unwrap();
    let text = |name: &str, shape: &[usize], data: &[f32]| {
        session.run(name, shape, data).unwrap_err().to_string()
    };
    assert!(text("picture", &image.shape, &image.data).contains("no input \"picture\""));
    let message = text("image", &[2, 3, 12, 8], &image.data);
    assert!(
        message.contains("[batch, 3, 8, 12]") && message.contains("net.onnx"),
        "{message}"
    );
    assert!(text("image", &[1, 3, 8, 12], &image.data).contains("needs 288 values, 576"));
    assert!(text("image", &[0, 3, 8, 12], &[]).contains("not a shape"));
    assert!(text("image", &[usize::MAX, 3, 8, 12], &[]).contains("not a shape"));
}

/// The way of an export: write, run the probe image, store what came out, read it back.
#[test]
fn a_probe_travels_with_the_file() {
    let (width, height) = (16, 8);
    let mut graph = GraphBuilder::new("probe");
    let dims = ["N".into(), 3.into(), 8.into(), 16.into()];
    let input = graph.input("image", &dims).unwrap();
    let head = graph
        .conv(
            "head",
            input,
            filter([2, 3, 3, 3], 2, 0),
            Geometry::new(1, 1),
        )
        .unwrap();
    graph.output("disparity", head).unwrap();
    let mut metadata = ModelMetadata::new(
        OutputMeaning::DisparityFraction,
        InputRange::Unit,
        width,
        height,
    );
    let bytes = graph.finish(Some(&metadata)).unwrap();

    let run = |bytes: &[u8]| {
        let session = EmbeddedSession::from_bytes(bytes.to_vec(), "probe", Some(1)).unwrap();
        let shape = [1, 3, height as usize, width as usize];
        session
            .run("image", &shape, &probe_image(width, height))
            .unwrap()
            .remove(0)
            .2
    };
    let output = run(&bytes);
    metadata.probe = Some(Probe::record(width, height, &output).unwrap());
    metadata.parity = Some(1.5e-8);
    let bytes = model::with_metadata(&bytes, &metadata).unwrap();

    let info = model::inspect(&bytes, "probe").unwrap();
    assert_eq!(info.metadata(), Some(&metadata));
    assert_eq!(info.description.problems, Vec::<String>::new());
    let probe = info.metadata().unwrap().probe.clone().unwrap();
    assert_eq!(probe.max_difference(&run(&bytes)), Ok(0.0));
    let mut off = output;
    off.iter_mut().for_each(|v| *v += 0.25);
    let difference = probe.max_difference(&off).unwrap();
    assert!((difference - 0.25).abs() < 1e-6, "{difference}");
}
