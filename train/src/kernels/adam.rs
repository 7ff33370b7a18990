//! Adam in one pass over memory, where burn makes ten.

use burn::backend::Flex;
use burn::optim::{Adam, AdamConfig, AdamState, AdaptiveMomentumState, LearningRate, Optimizer};
use burn::tensor::{Device, Tensor};
use rayon::prelude::*;
use rten_simd::{Isa, SimdOp};

use super::cpu::{Cpu, is_f32, values};

/// Adam (Kingma and Ba 2015) as burn computes it, with the same state; on the CPU in one pass and with
/// the same bits.
#[derive(Clone)]
pub(crate) struct FusedAdam {
    by_parts: Adam,
    beta_1: f32,
    beta_2: f32,
    epsilon: f32,
}

/// Elements that one thread works on at a time.
const PIECE: usize = 1 << 14;

impl FusedAdam {
    pub fn new(beta_1: f32, beta_2: f32, epsilon: f32) -> Self {
        let config = AdamConfig::new()
            .with_beta_1(beta_1)
            .with_beta_2(beta_2)
            .with_epsilon(epsilon);
        Self {
            by_parts: config.build(),
            beta_1,
            beta_2,
            epsilon,
        }
    }

    /// The weights after step `time`, in the place of the gradient, and the new moments.
    fn update(
        &self,
        rate: f64,
        time: usize,
        weights: &Cpu,
        [gradient, first, second]: &mut [Cpu; 3],
    ) {
        let time = time as i32;
        // As burn computes them, in this precision and order.
        let correction = (1.0 - self.beta_2.powi(time)).sqrt();
        let step = Step {
            beta_1: self.beta_1,
            beta_2: self.beta_2,
            rest_1: 1.0 - self.beta_1,
            rest_2: 1.0 - self.beta_2,
            combined: correction / (1.0 - self.beta_1.powi(time)),
            epsilon: self.epsilon * correction,
            rate: rate as f32,
        };
        let gradient: &mut [f32] = gradient.storage_mut();
        let (first, second): (&mut [f32], &mut [f32]) = (first.storage_mut(), second.storage_mut());
        let weights = values(weights);
        assert_eq!(weights.len(), gradient.len(), "one gradient per weight");
        assert_eq!(weights.len(), first.len(), "one moment per weight");
        gradient
            .par_chunks_mut(PIECE)
            .zip(first.par_chunks_mut(PIECE))
            .zip(second.par_chunks_mut(PIECE))
            .zip(weights.par_chunks(PIECE))
            .for_each(|(((gradient, first), second), weights)| {
                let part = Part {
                    step,
                    gradient,
                    first,
                    second,
                    weights,
                };
                part.dispatch();
            });
    }
}

/// The numbers of one step.
#[derive(Clone, Copy)]
struct Step {
    beta_1: f32,
    beta_2: f32,
    rest_1: f32,
    rest_2: f32,
    combined: f32,
    epsilon: f32,
    rate: f32,
}

/// Some of the weights, their moments, and their gradient, in whose place the new weights are written.
struct Part<'a> {
    step: Step,
    gradient: &'a mut [f32],
    first: &'a mut [f32],
    second: &'a mut [f32],
    weights: &'a [f32],
}

impl SimdOp for Part<'_> {
    type Output = ();

    #[inline(always)]
    fn eval<I: Isa>(self, _: I) {
        let step = self.step;
        let moments = self.first.iter_mut().zip(self.second);
        let weights = self.gradient.iter_mut().zip(moments).zip(self.weights);
        for ((found, (first, second)), weight) in weights {
            let gradient = *found;
            *first = *first * step.beta_1 + gradient * step.rest_1;
            *second = *second * step.beta_2 + gradient * gradient * step.rest_2;
            let direction = *first * step.combined / (second.sqrt() + step.epsilon);
            *found = weight - direction * step.rate;
        }
    }
}

/// The tensor's contiguous numbers on the CPU, held by nothing else where `tensor` was not.
fn into_plain<const D: usize>(tensor: Tensor<D>) -> Cpu {
    let tensor = tensor.try_into_primitive::<Flex>();
    tensor.expect("checked to be on the CPU").to_contiguous()
}

fn suits<const D: usize>(tensor: &Tensor<D>) -> bool {
    let tensor = tensor.clone().try_into_primitive::<Flex>();
    tensor.is_ok_and(|tensor| is_f32(&tensor))
}

impl Optimizer for FusedAdam {
    type State<const D: usize> = AdamState<D>;

    fn step<const D: usize>(
        &self,
        rate: LearningRate,
        tensor: Tensor<D>,
        gradient: Tensor<D>,
        state: Option<AdamState<D>>,
    ) -> (Tensor<D>, Option<AdamState<D>>) {
        let state = match state {
            Some(state) if suits(&tensor) && suits(&gradient) => state.momentum,
            // The first step of all makes the moments.
            state => return self.by_parts.step(rate, tensor, gradient, state),
        };
        let time = state.time + 1;
        let weights = into_plain(tensor);
        let mut changed = [gradient, state.moment_1, state.moment_2].map(into_plain);
        self.update(rate, time, &weights, &mut changed);
        let [tensor, first, second] = changed.map(Tensor::from_primitive::<Flex>);
        let momentum = AdaptiveMomentumState::new(time, first, second);
        (tensor, Some(AdamState::new(momentum)))
    }

    fn to_device<const D: usize>(state: AdamState<D>, device: &Device) -> AdamState<D> {
        Adam::to_device(state, device)
    }
}

#[cfg(test)]
mod tests {
    use burn::tensor::Distribution;

    use super::*;
    use crate::network::layers::values_of;

    #[test]
    fn steps_have_the_bits_of_burn() {
        let device = Device::flex();
        let fused = FusedAdam::new(0.9, 0.999, 1e-8);
        let random = |scale: f64| {
            let range = Distribution::Uniform(-scale, scale);
            Tensor::<2>::random([3, 7], range, &device)
        };
        let mut found = (random(1.0), None);
        let mut expected = found.clone();
        for step in 0..5 {
            let gradient = random(0.1_f64.powi(step));
            let rate = 1e-2 / f64::from(step + 1);
            let before = values_of(found.0.clone());
            found = fused.step(rate, found.0, gradient.clone(), found.1);
            expected = fused.by_parts.step(rate, expected.0, gradient, expected.1);
            assert_ne!(values_of(found.0.clone()), before);
            assert_eq!(values_of(found.0.clone()), values_of(expected.0.clone()));
        }
        let moments = |state: Option<AdamState<2>>| {
            let state = state.expect("a state").momentum;
            let numbers = [state.moment_1, state.moment_2].map(values_of);
            (state.time, numbers)
        };
        assert_eq!(moments(found.1), moments(expected.1));
    }
}
