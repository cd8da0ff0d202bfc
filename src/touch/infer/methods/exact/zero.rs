//! What the offsets of a readout have drifted by since the skin was calibrated, from live frames in which
//! nothing is found.
//! PURE. Uses: nothing. Never: a frame with a contact.

/// Number of untouched frames over which the zero follows, 10 s at 30 frames per second: slowly enough that
/// the noise averages out, quickly enough for drifts over minutes.
const FOLLOWS: f64 = 300.0;
/// Number of frames in the mean from which a frame without contact is taken as untouched: one frame may hide
/// a light touch.
const SURE_FRAMES: f64 = 15.0;

/// Offsets of a stream of frames, relative to those of the calibration.
#[derive(Debug, Clone, Default)]
pub struct Zero {
    offset_v: Vec<f64>,
    frames: f64,
}

impl Zero {
    /// Subtracts the zero from a frame, V.
    pub fn take_off(&self, frame_v: &mut [f64]) {
        frame_v.iter_mut().zip(&self.offset_v).for_each(|(v, offset)| *v -= offset);
    }

    /// Learns from a frame from which the zero is already subtracted, V: `contacts` were found in the mean
    /// of the last `averaged` frames.
    pub fn learn(&mut self, frame_v: &[f64], contacts: usize, averaged: f64) {
        if contacts > 0 || averaged < SURE_FRAMES {
            return;
        }
        self.offset_v.resize(frame_v.len(), 0.0);
        self.frames = (self.frames + 1.0).min(FOLLOWS);
        let share = 1.0 / (self.frames + SURE_FRAMES);
        self.offset_v.iter_mut().zip(frame_v).for_each(|(offset, v)| *offset += share * v);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_zero_follows_untouched_frames_and_no_others() {
        let mut zero = Zero::default();
        let read = |zero: &Zero, v: f64| {
            let mut frame = [v, -v];
            zero.take_off(&mut frame);
            frame
        };
        for _ in 0..1000 {
            let frame = read(&zero, 1e-3);
            zero.learn(&frame, 0, 30.0);
        }
        assert!(read(&zero, 1e-3).iter().all(|v| v.abs() < 1e-4));
        let before = zero.clone();
        zero.learn(&[5e-3, 5e-3], 1, 30.0);
        zero.learn(&[5e-3, 5e-3], 0, 1.0);
        assert_eq!(read(&before, 1e-3), read(&zero, 1e-3));
    }
}
