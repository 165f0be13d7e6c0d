//! Rounding, which `core` does not have for floats yet.

macro_rules! define_round {
    ($name:ident $float:ident $int:ident, whole_from $limit:literal) => {
        /// The nearest whole number, halves away from zero.
        #[inline]
        pub(crate) const fn $name(x: $float) -> $float {
            if !(x > -$limit && x < $limit) {
                return x; // already whole, or not a number
            }
            let whole = x as $int as $float;
            let rest = x - whole;
            if rest >= 0.5 {
                whole + 1.0
            } else if rest <= -0.5 {
                whole - 1.0
            } else {
                whole
            }
        }
    };
}
define_round!(round_f32 f32 i32, whole_from 8_388_608.0);
define_round!(round_f64 f64 i64, whole_from 4_503_599_627_370_496.0);

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn halves_go_away_from_zero() {
        assert_eq!(round_f32(0.499_999_97), 0.0);
        assert_eq!(round_f32(0.5), 1.0);
        assert_eq!(round_f32(-0.5), -1.0);
        assert_eq!(round_f32(-2.4), -2.0);
        assert_eq!(round_f32(8_388_609.0), 8_388_609.0);
        assert_eq!(round_f64(4_503_599_627_370_497.0), 4_503_599_627_370_497.0);
        assert!(round_f32(f32::NAN).is_nan());
    }
}
