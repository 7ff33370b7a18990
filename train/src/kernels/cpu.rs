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

#[cfg(test)]
mod tests {
    use burn::backend::Flex;
    use burn::tensor::Device;

    use super::*;

    #[test]
    #[should_panic(expected = "contiguous f32")]
    fn a_tensor_that_is_not_contiguous_is_no_empty_slice() {
        let rows =
            Tensor::<2>::from_data(TensorData::new(vec![1.0_f32; 6], [2, 3]), &Device::flex());
        let turned = rows.swap_dims(0, 1).try_into_primitive::<Flex>();
        let _ = values(&turned.expect("on the CPU"));
    }
}
