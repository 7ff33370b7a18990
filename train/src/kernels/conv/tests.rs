//! Values and gradients against burn's own operations.

use burn::tensor::{Device, Distribution, Tensor};

use super::*;
use crate::network::layers::values_of;

/// Output, and gradients with respect to input, weight, bias and what is added.
type Results = [Vec<f32>; 5];

fn random<const D: usize>(shape: [usize; D], device: &Device) -> Tensor<D> {
    Tensor::random(shape, Distribution::Uniform(-1.0, 1.0), device)
}

/// The two ways to compute it: the one under test, and burn's.
fn both(
    convolving: Convolving,
    input: [usize; 4],
    [outputs, kernel]: [usize; 2],
    added: bool,
) -> [Results; 2] {
    let plain = Device::flex();
    let inputs = input[1];
    let weight_shape = match convolving.transposed {
        true => [inputs, outputs, kernel, kernel],
        false => [outputs, inputs, kernel, kernel],
    };
    let geometry = convolving.geometry(input, weight_shape);
    let [channels, height, width] = match convolving.transposed {
        true => geometry.large,
        false => geometry.small,
    };
    let input = random(input, &plain);
    let weight = random(weight_shape, &plain);
    let bias = random([outputs], &plain);
    let added = added.then(|| random([geometry.batch, channels, height, width], &plain));
    let outer = random([geometry.batch, channels, height, width], &plain);
    [Convolving::apply, Convolving::by_parts].map(|function| {
        let leaf = |tensor: &Tensor<4>| tensor.clone().autodiff().require_grad();
        let (input, weight) = (leaf(&input), leaf(&weight));
        let bias = bias.clone().autodiff().require_grad();
        let added = added.as_ref().map(leaf);
        let output = function(
            convolving,
            input.clone(),
            weight.clone(),
            bias.clone(),
            added.clone(),
        );
        let gradients = (output.clone() * outer.clone().autodiff()).sum().backward();
        let of = |tensor: &Tensor<4>| values_of(tensor.grad(&gradients).expect("a gradient"));
        [
            values_of(output.inner()),
            of(&input),
            of(&weight),
            values_of(bias.grad(&gradients).expect("a gradient")),
            added.as_ref().map(of).unwrap_or_default(),
        ]
    })
}

fn assert_equal(found: &Results, expected: &Results, what: &str) {
    let names = ["values", "input", "weight", "bias", "added"];
    for ((found, expected), name) in found.iter().zip(expected).zip(names) {
        assert_eq!(found.len(), expected.len(), "{what}: {name}");
        let largest = expected
            .iter()
            .fold(1.0_f32, |most, value| most.max(value.abs()));
        for (found, expected) in found.iter().zip(expected) {
            let error = (found - expected).abs() / largest;
            assert!(error < 1e-5, "{what}: {name}: {found} {expected}");
        }
    }
}

const KINDS: [Option<Activation>; 3] = [None, Some(Activation::Elu), Some(Activation::LeakyRelu)];

/// Sizes, channels and batches that leave rests everywhere, and that take every way through the passes.
#[test]
fn convolutions_equal_those_of_burn() {
    let cases = [
        // input, [outputs, kernel], stride, padding
        ([1, 3, 14, 18], [5, 7], 2, 3),
        ([2, 18, 33, 40], [16, 3], 1, 1),
        ([3, 9, 8, 8], [17, 3], 2, 1),
        ([1, 4, 9, 7], [2, 3], 2, 1),
        ([5, 12, 2, 3], [20, 3], 1, 1),
        ([2, 70, 8, 16], [130, 1], 1, 0),
        ([2, 6, 9, 12], [7, 1], 2, 0),
        ([1, 6, 32, 34], [10, 4], 2, 1),
        ([2, 5, 7, 8], [1, 4], 1, 1),
        ([1, 90, 4, 8], [300, 3], 1, 1),
        ([1, 2, 70, 600], [3, 3], 1, 1),
        ([4, 3, 1, 1], [2, 1], 1, 0),
    ];
    for (number, (input, outputs, stride, padding)) in cases.into_iter().enumerate() {
        let convolving = Convolving {
            stride,
            padding,
            transposed: false,
            activation: KINDS[number % 3],
        };
        let [found, expected] = both(convolving, input, outputs, number % 2 == 0);
        assert_equal(&found, &expected, &format!("{input:?} {convolving:?}"));
    }
}

#[test]
fn transposed_convolutions_equal_those_of_burn() {
    for (number, (input, outputs)) in [
        ([1, 32, 5, 9], 16),
        ([3, 7, 2, 4], 5),
        ([1, 3, 40, 64], 2),
        ([2, 80, 1, 2], 70),
    ]
    .into_iter()
    .enumerate()
    {
        let convolving = Convolving {
            stride: 2,
            padding: 1,
            transposed: true,
            activation: KINDS[number % 3],
        };
        let [found, expected] = both(convolving, input, [outputs, 4], false);
        assert_equal(&found, &expected, &format!("{input:?} {convolving:?}"));
    }
}

/// Several inputs are as good as one that holds them all, to the bit, and so are their gradients.
#[test]
fn inputs_need_not_be_put_together() {
    let device = Device::flex();
    for (channels, kernel) in [(&[5, 9, 2][..], 3), (&[16, 3], 3), (&[4, 4, 2], 1)] {
        let inputs: Vec<Tensor<4>> = channels
            .iter()
            .map(|&channels| random([2, channels, 12, 40], &device))
            .collect();
        let all: usize = channels.iter().sum();
        let weight = random([7, all, kernel, kernel], &device);
        let bias = random([7], &device);
        let outer = random([2, 7, 12, 40], &device).autodiff();
        let convolving = Convolving {
            stride: 1,
            padding: kernel / 2,
            transposed: false,
            activation: Some(Activation::Elu),
        };
        let run = |apart: bool| {
            let leaf = |tensor: &Tensor<4>| tensor.clone().autodiff().require_grad();
            let (leaves, weight) = (inputs.iter().map(leaf).collect::<Vec<_>>(), leaf(&weight));
            let bias = bias.clone().autodiff().require_grad();
            let given = match apart {
                true => leaves.clone(),
                false => vec![Tensor::cat(leaves.clone(), 1)],
            };
            let output = convolving.apply_to(given, weight.clone(), bias.clone(), None);
            let gradients = (output.clone() * outer.clone()).sum().backward();
            let of = |tensor: &Tensor<4>| values_of(tensor.grad(&gradients).expect("a gradient"));
            let mut results = vec![values_of(output.inner()), of(&weight)];
            results.push(values_of(bias.grad(&gradients).expect("a gradient")));
            results.extend(leaves.iter().map(of));
            results
        };
        assert_eq!(run(true), run(false), "{channels:?}");
        let plain = convolving.apply_to(inputs.clone(), weight.clone(), bias.clone(), None);
        assert_eq!(values_of(plain), run(false)[0]);
    }
}

/// The same without a graph, and the same bits for any number of threads.
#[test]
fn threads_change_no_bit() {
    let device = Device::flex();
    let (input, weight) = (
        random([2, 18, 40, 70], &device),
        random([33, 18, 3, 3], &device),
    );
    let bias = random([33], &device);
    let run = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build();
        pool.expect("a pool of threads").install(|| {
            let leaf = |tensor: &Tensor<4>| tensor.clone().autodiff().require_grad();
            let (input, weight) = (leaf(&input), leaf(&weight));
            let bias = bias.clone().autodiff();
            let convolving = Convolving {
                stride: 1,
                padding: 1,
                transposed: false,
                activation: Some(Activation::Elu),
            };
            let output = convolving.apply(input.clone(), weight.clone(), bias, None);
            let gradients = output.clone().sum().backward();
            let of = |tensor: &Tensor<4>| values_of(tensor.grad(&gradients).expect("a gradient"));
            [values_of(output.inner()), of(&input), of(&weight)]
        })
    };
    let one = run(1);
    assert_eq!(one, run(2));
    assert_eq!(one, run(5));
    let convolving = Convolving {
        stride: 1,
        padding: 1,
        transposed: false,
        activation: Some(Activation::Elu),
    };
    let plain = convolving.apply(input, weight, bias, None);
    assert_eq!(values_of(plain), one[0]);
}
