//! Networks that load well and go wrong later.

use std::path::Path;

use prost::Message as _;
use strat_onnx::{
    metadata::ModelMetadata,
    proto::{
        AttributeProto, Dimension, GraphProto, ModelProto, NodeProto, TensorProto,
        TensorShapeProto, TypeProto, ValueInfoProto, attribute_type, data_type, type_proto,
    },
};

/// How the network of [`crate::fixtures::network`] is spoilt.
#[derive(Clone, Copy, Debug)]
pub enum Fault {
    /// Every prediction gets the mean over the batch added: right for single images only.
    MixesBatch,
    /// The output is pressed into a shape, which is known to be impossible only when it runs.
    Reshape([i64; 4]),
    /// The output is multiplied by one for ever.
    Loops,
    /// Numbers for nothing, this many.
    Fills(i64),
    /// The output is enlarged to this many rows and columns.
    Grows(i64),
}

/// Puts a faulty layer behind a network's output.
pub fn spoil(bytes: &[u8], fault: Fault) -> Vec<u8> {
    let mut model = ModelProto::decode(bytes).unwrap();
    let graph = model.graph.as_mut().unwrap();
    for node in &mut graph.node {
        for output in &mut node.output {
            if output == "disparity" {
                "sound".clone_into(output);
            }
        }
    }
    let node =
        |op: &str, inputs: &[&str], output: &str, attribute: Vec<AttributeProto>| NodeProto {
            input: inputs.iter().map(ToString::to_string).collect(),
            output: vec![output.to_owned()],
            name: Some(format!("{output}_{op}")),
            op_type: Some(op.to_owned()),
            attribute,
            ..NodeProto::default()
        };
    match fault {
        Fault::MixesBatch => {
            let axes = AttributeProto {
                name: Some("axes".to_owned()),
                ints: vec![0],
                r#type: Some(attribute_type::INTS),
                ..AttributeProto::default()
            };
            let mean = node("ReduceMean", &["sound"], "mean", vec![axes]);
            graph.node.push(mean);
            let sum = node("Add", &["sound", "mean"], "disparity", Vec::new());
            graph.node.push(sum);
        }
        Fault::Loops => {
            graph.initializer.extend([
                TensorProto {
                    data_type: Some(data_type::INT64),
                    int64_data: vec![i64::MAX],
                    name: Some("trips".to_owned()),
                    ..TensorProto::default()
                },
                TensorProto {
                    data_type: Some(data_type::BOOL),
                    int32_data: vec![1],
                    name: Some("on".to_owned()),
                    ..TensorProto::default()
                },
            ]);
            let body = GraphProto {
                name: Some("body".to_owned()),
                input: vec![
                    typed("trip", data_type::INT64, Some(Vec::new())),
                    typed("before", data_type::BOOL, Some(Vec::new())),
                    typed("value", data_type::FLOAT, None),
                ],
                output: vec![
                    typed("after", data_type::BOOL, Some(Vec::new())),
                    typed("next", data_type::FLOAT, None),
                ],
                node: vec![
                    node("Identity", &["before"], "after", Vec::new()),
                    node("Neg", &["value"], "next", Vec::new()),
                ],
                ..GraphProto::default()
            };
            let body = AttributeProto {
                name: Some("body".to_owned()),
                g: Some(body),
                // GRAPH (AttributeProto.AttributeType).
                r#type: Some(5),
                ..AttributeProto::default()
            };
            let inputs = ["trips", "on", "sound"];
            graph
                .node
                .push(node("Loop", &inputs, "disparity", vec![body]));
        }
        Fault::Fills(count) => {
            graph.initializer.push(TensorProto {
                dims: vec![1],
                data_type: Some(data_type::INT64),
                int64_data: vec![count],
                name: Some("count".to_owned()),
                ..TensorProto::default()
            });
            graph.node.extend([
                node("ConstantOfShape", &["count"], "many", Vec::new()),
                node("ReduceSum", &["many"], "nothing", Vec::new()),
                node("Add", &["sound", "nothing"], "disparity", Vec::new()),
            ]);
        }
        Fault::Grows(side) => {
            graph.initializer.push(TensorProto {
                dims: vec![4],
                data_type: Some(data_type::INT64),
                int64_data: vec![1, 1, side, side],
                name: Some("size".to_owned()),
                ..TensorProto::default()
            });
            let maximum = node("GlobalMaxPool", &["sound"], "one", Vec::new());
            let expand = node("Expand", &["one", "size"], "disparity", Vec::new());
            graph.node.extend([maximum, expand]);
            for output in &mut graph.output {
                output.r#type.as_mut().unwrap().value = None;
            }
        }
        Fault::Reshape(shape) => {
            graph.initializer.push(TensorProto {
                dims: vec![4],
                data_type: Some(data_type::INT64),
                int64_data: shape.to_vec(),
                name: Some("shape".to_owned()),
                ..TensorProto::default()
            });
            let reshape = node("Reshape", &["sound", "shape"], "disparity", Vec::new());
            graph.node.push(reshape);
            for output in &mut graph.output {
                output.r#type.as_mut().unwrap().value = None;
            }
        }
    }
    model.encode_to_vec()
}

/// A value of a subgraph.
fn typed(name: &str, kind: i32, dims: Option<Vec<Dimension>>) -> ValueInfoProto {
    let tensor = type_proto::Tensor {
        elem_type: Some(kind),
        shape: dims.map(|dim| TensorShapeProto { dim }),
    };
    ValueInfoProto {
        name: Some(name.to_owned()),
        r#type: Some(TypeProto {
            value: Some(type_proto::Value::TensorType(tensor)),
            denotation: None,
        }),
        ..ValueInfoProto::default()
    }
}

/// Fixes the first dimension of the input and the output at 1.
pub fn fix_batch(bytes: &[u8]) -> Vec<u8> {
    let mut model = ModelProto::decode(bytes).unwrap();
    let graph = model.graph.as_mut().unwrap();
    for info in graph.input.iter_mut().chain(&mut graph.output) {
        declare(info, &[(0, 1)]);
    }
    model.encode_to_vec()
}

/// Declares an input, and an output, of this many rows and columns.
pub fn with_input(bytes: &[u8], side: i64) -> Vec<u8> {
    let mut model = ModelProto::decode(bytes).unwrap();
    let graph = model.graph.as_mut().unwrap();
    for info in graph.input.iter_mut().chain(&mut graph.output) {
        declare(info, &[(2, side), (3, side)]);
    }
    model.encode_to_vec()
}

/// Fixes dimensions of a value.
fn declare(info: &mut ValueInfoProto, sizes: &[(usize, i64)]) {
    use strat_onnx::proto::dimension;
    let Some(type_proto::Value::TensorType(tensor)) =
        info.r#type.as_mut().and_then(|kind| kind.value.as_mut())
    else {
        panic!("not a tensor");
    };
    let shape = tensor.shape.as_mut().unwrap();
    for &(at, size) in sizes {
        shape.dim[at].value = Some(dimension::Value::DimValue(size));
    }
}

/// Writes a spoilt network, with metadata and without a probe.
pub fn write_spoilt(folder: &Path, name: &str, metadata: &ModelMetadata, fault: Fault) -> String {
    let plain = crate::fixtures::network(0.04, 0.1, Some(metadata));
    let path = folder.join(format!("{name}.onnx"));
    std::fs::write(&path, spoil(&plain, fault)).unwrap();
    path.to_str().unwrap().to_owned()
}
