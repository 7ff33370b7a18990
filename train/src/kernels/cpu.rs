//! Tensors of the CPU backend as slices of numbers, plain or in a graph of gradients.

use burn::backend::tensor::FloatTensor;
use burn::backend::{Autodiff, Flex};
use burn::tensor::{Tensor, TensorData};

/// A tensor of the CPU backend.
pub(super) type Cpu = FloatTensor<Flex>;
/// A tensor of the CPU backend in a graph.
pub(super) type Tracked = FloatTensor<Autodiff<Flex>>;

pub(super) fn is_f32(tensor: &Cpu) -> bool {
    tensor.dtype() == burn::tensor::DType::F32
}

pub(super) fn tracked<const D: usize>(tensor: &Tensor<D>) -> Option<Tracked> {
    tensor
        .clone()
        .autodiff()
        .try_into_primitive::<Autodiff<Flex>>()
        .ok()
}

/// The tensor as contiguous numbers of the CPU; `None` where it is none.
pub(super) fn plain<const D: usize>(tensor: &Tensor<D>) -> Option<Cpu> {
    let tensor = tensor.clone().try_into_primitive::<Flex>().ok()?;
    is_f32(&tensor).then(|| tensor.to_contiguous())
}

pub(super) fn from_plain(tensor: Cpu) -> Tensor<4> {
    Tensor::from_primitive::<Flex>(tensor)
}

pub(super) fn from_tracked(tensor: Tracked) -> Tensor<4> {
    Tensor::from_primitive::<Autodiff<Flex>>(tensor)
}

pub(super) fn dims(tensor: &Cpu) -> [usize; 4] {
    let shape = tensor.layout().shape();
    [shape[0], shape[1], shape[2], shape[3]]
}

/// Elements of a contiguous `f32` tensor.
///
/// Anything else is a mistake of this module's callers, which would go on with wrong gradients.
pub(super) fn values(tensor: &Cpu) -> &[f32] {
    tensor
        .as_slice::<f32>()
        .expect("contiguous f32: every caller has called to_contiguous and is_f32")
}

pub(super) fn cpu_tensor(values: Vec<f32>, shape: &[usize]) -> Cpu {
    Cpu::from_data(TensorData::new(values, shape.to_vec()))
}

/// Sum of a function of the elements of several slices of one length, in sixteen lanes, which is both
/// faster and more exact than one running sum.
#[inline(always)]
pub(super) fn sum<const N: usize>(slices: [&[f32]; N], function: impl Fn([f32; N]) -> f32) -> f32 {
    const LANES: usize = 16;
    let mut lanes = [0.0_f32; LANES];
    let chunks = slices.map(|slice| slice.as_chunks::<LANES>());
    let count = chunks
        .iter()
        .map(|(chunks, _)| chunks.len())
        .min()
        .unwrap_or(0);
    for chunk in 0..count {
        let values = chunks.map(|(chunks, _)| &chunks[chunk]);
        for (lane, sum) in lanes.iter_mut().enumerate() {
            *sum += function(values.map(|values| values[lane]));
        }
    }
    let rests = chunks.map(|(_, rest)| rest);
    let rest = (0..rests.first().map_or(0, |rest| rest.len()))
        .map(|place| function(rests.map(|rest| rest[place])));
    lanes.iter().sum::<f32>() + rest.sum::<f32>()
}

#[cfg(test)]
mod tests {
    use burn::backend::Flex;
    use burn::tensor::Device;

    use super::*;

    #[test]
    fn sums_take_all_elements() {
        let numbers: Vec<f32> = (1..=37).map(|v| v as f32).collect();
        assert_eq!(sum([&numbers], |[v]| v), 703.0);
        assert_eq!(sum([&numbers, &numbers], |[a, b]| a - b), 0.0);
        assert_eq!(sum([&numbers[..5]], |[v]| v * v), 55.0);
        assert_eq!(sum([&[]], |[v]| v), 0.0);
    }

    #[test]
    #[should_panic(expected = "contiguous f32")]
    fn a_tensor_that_is_not_contiguous_is_no_empty_slice() {
        let rows =
            Tensor::<2>::from_data(TensorData::new(vec![1.0_f32; 6], [2, 3]), &Device::flex());
        let turned = rows.swap_dims(0, 1).try_into_primitive::<Flex>();
        let _ = values(&turned.expect("on the CPU"));
    }
}
