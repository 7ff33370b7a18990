//! The natural logarithm, the same to the last bit on every machine.
//!
//! A platform's own logarithm is right up to a last bit that differs between libraries, and with it the last
//! digits of what was measured. This one consists of operations that IEEE 754 defines to the bit, and has no
//! branches, so that processors work out several at a time. With x = 2^k (1 + f), 1 + f between the roots of 1/2 and
//! 2, and s = f / (2 + f), it is k ln 2 + ln(1 + f), and ln(1 + f) is the series 2 (s + s^3/3 + s^5/5 + ...),
//! written as f minus what is small, so that little is lost by rounding. It is within 0.8 units in the last place.
//! Not here: numbers that are not positive, or smaller than [`f64::MIN_POSITIVE`].

/// The root of 1/2.
const ROOT_BITS: u64 = 0x3fe6_a09e_667f_3bcd;
const ONE_BITS: u64 = 1_f64.to_bits();
const MANTISSA_BITS: u64 = (1 << 52) - 1;
/// 2^52: numbers from there to its double have whole numbers for their last bits.
const WHOLE: f64 = (1_u64 << 52) as f64;
const EXPONENT_OF_ONE: f64 = 1023.0;

/// ln 2 in two parts; the first has 21 bits, so that any exponent times it is exact.
const LN_2_HIGH: f64 = 0.693_146_705_627_441_4;
const LN_2_LOW: f64 = 4.749_325_039_031_672_6e-7;

/// Twice what the powers of s from the third on are divided by; s^2 is below 0.0295, so what comes after these ten is
/// below 2^-55 of the first.
const SERIES: [f64; 10] = [
    2.0 / 3.0,
    2.0 / 5.0,
    2.0 / 7.0,
    2.0 / 9.0,
    2.0 / 11.0,
    2.0 / 13.0,
    2.0 / 15.0,
    2.0 / 17.0,
    2.0 / 19.0,
    2.0 / 21.0,
];

/// The natural logarithm of a positive number.
#[inline(always)]
pub(crate) fn ln(x: f64) -> f64 {
    // The exponent changes at the roots of powers of 2 instead of the powers themselves.
    let shifted = x.to_bits().wrapping_add(ONE_BITS - ROOT_BITS);
    let exponent = f64::from_bits(WHOLE.to_bits() | shifted >> 52) - (WHOLE + EXPONENT_OF_ONE);
    let mantissa = f64::from_bits((shifted & MANTISSA_BITS) + ROOT_BITS);
    let f = mantissa - 1.0;
    let s = f / (2.0 + f);
    let squared = s * s;
    let fourth = squared * squared;
    // Two sums that do not wait for each other.
    let [c1, c2, c3, c4, c5, c6, c7, c8, c9, c10] = SERIES;
    let odd = squared * (c1 + fourth * (c3 + fourth * (c5 + fourth * (c7 + fourth * c9))));
    let even = fourth * (c2 + fourth * (c4 + fourth * (c6 + fourth * (c8 + fourth * c10))));
    let series = even + odd;
    let half = 0.5 * f * f;
    exponent * LN_2_HIGH - ((half - (s * (half + series) + exponent * LN_2_LOW)) - f)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Numbers of all sizes, many of them around 1.
    fn numbers() -> impl Iterator<Item = f64> {
        (0..200_000_u64).map(|index| {
            let mixed = index.wrapping_mul(0x9e37_79b9_7f4a_7c15);
            let mantissa = mixed >> 12;
            let exponent = match index % 4 {
                0 => 1 + index % 2046,
                1 => 1022,
                2 => 1023,
                _ => 1016 + index % 16,
            };
            f64::from_bits(exponent << 52 | mantissa)
        })
    }

    #[test]
    fn logarithms_are_those_of_the_platform_up_to_the_last_place() {
        let mut differ = 0;
        for x in numbers().chain([
            f64::MIN_POSITIVE,
            f64::MAX,
            1.0,
            1_f64.next_down(),
            1_f64.next_up(),
        ]) {
            let (found, expected) = (ln(x), x.ln());
            // The platform's own is within one place itself.
            let place = (expected.next_up() - expected)
                .abs()
                .max((expected - expected.next_down()).abs());
            assert!(
                (found - expected).abs() <= 1.01 * place,
                "{x:e}: {found:e}, not {expected:e}"
            );
            differ += usize::from(found != expected);
        }
        assert_eq!(ln(1.0), 0.0);
        assert!(differ < 10_000, "{differ}");
    }

    #[test]
    fn bits_are_the_same_on_every_machine() {
        // Recipe: make_golden.py metrics/logarithm: the sum of bits times their places from 1 on.
        let weighted = (1..).zip(numbers().map(|x| ln(x).to_bits()));
        let sum = weighted.fold(0_u64, |sum, (place, bits): (u64, u64)| {
            sum.wrapping_add(bits.wrapping_mul(place))
        });
        assert_eq!(sum, 611_368_949_739_275_748);
    }
}
