//! 32-bit values in pairs of registers, high word first: the order of all supported devices.
//! PURE. Uses: nothing. Never: addresses, units.

/// Converts a value to its two registers.
pub fn to_words(value: i32) -> [u16; 2] {
    let bits = value as u32;
    [(bits >> 16) as u16, bits as u16]
}

/// Value of the two registers that start at `at`; `None` if the block is too short.
pub fn from_words(words: &[u16], at: usize) -> Option<i32> {
    let pair = words.get(at..at + 2)?;
    Some(((u32::from(pair[0]) << 16) | u32::from(pair[1])) as i32)
}

/// Whether bit `n` of a register is set.
pub fn bit(word: u16, n: u32) -> bool {
    word >> n & 1 == 1
}

/// Converts a physical value to a register value: rounded, from 1 to `max`.
pub fn to_count(value: f64, max: i32) -> i32 {
    (value.round() as i32).clamp(1, max)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn every_value_survives_its_two_registers(value: i32) {
            let [high, low] = to_words(value);
            prop_assert_eq!(from_words(&[7, high, low], 1), Some(value));
        }
    }

    #[test]
    fn the_high_word_stands_first() {
        assert_eq!(to_words(0x0001_0002), [1, 2]);
        assert_eq!(to_words(-2), [0xFFFF, 0xFFFE]);
        assert_eq!(from_words(&[1], 0), None);
    }
}
