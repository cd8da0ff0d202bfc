//! Sampling times of frames on the host's clock: which frames a trial may use.
//! PURE (times are passed in). Uses: nothing. Never: ports, waits.
//!
//! A frame that arrives after settling may have been sampled before it, because its bytes wait in
//! the device, in a serial server or in the kernel. It is therefore judged by the device time of
//! its first sample. Host time minus device time of an arrival is the offset of the clocks plus the
//! latency of that frame. Its minimum over a sliding window is the offset plus the minimum latency.
//! The known part of the minimum latency is subtracted: a frame is sent after its last sample, one
//! frame period after the first, and a serial line needs time for the bytes. The remaining unknown
//! part (kernel and network) would make a frame appear younger than it is, so a margin is
//! subtracted too. The estimate is thus early rather than late, and a frame that is accepted was
//! sampled after the requested time.
//!
//! Frames that waited in a buffer while the wire was closed arrive in a burst once it is opened, and
//! the minimum falls with each of them. There is therefore no estimate before frames have arrived
//! for some periods without a fall.
//!
//! All times are process seconds: the clock of the device runs with the process (`clock_rate`). If
//! it does not, the estimate is too early and no frame is accepted: the rig check reports it.

/// Half of the sliding window, wall s.
const HALF_WINDOW_S: f64 = 5.0;
/// Assumed minimum latency of kernel and network, wall s.
const TRANSPORT_MARGIN_S: f64 = 0.0002;
/// Fall of the minimum, and time without such a fall after which it is trusted, frame periods.
const FALL_PERIODS: f64 = 0.25;
const STEADY_PERIODS: f64 = 5.0;

/// Estimate of the offset between host time and device time.
#[derive(Debug, Clone)]
pub struct DeviceTiming {
    period_s: f64,
    lead_s: f64,
    half_window_s: f64,
    half_began_s: f64,
    least_now: f64,
    least_before: f64,
    last_device_us: u64,
    last_host_s: f64,
    /// Minimum from which falls are counted; those of a slowly drained buffer add up.
    steady_least: f64,
    /// Host time from which the minimum is trusted.
    steady_s: f64,
}

impl DeviceTiming {
    /// Creates the estimate for a device with this frame period, whose packets need `sending_s` on
    /// the wire, on a rig at `rate` process seconds per wall second. Both times are process s: the
    /// line of an accelerated virtual rig is accelerated too.
    pub fn new(frame_period_s: f64, sending_s: f64, rate: f64) -> Self {
        Self {
            period_s: frame_period_s,
            lead_s: frame_period_s + sending_s + TRANSPORT_MARGIN_S * rate,
            half_window_s: HALF_WINDOW_S * rate,
            half_began_s: f64::NEG_INFINITY,
            least_now: f64::INFINITY,
            least_before: f64::INFINITY,
            last_device_us: 0,
            last_host_s: f64::NEG_INFINITY,
            steady_least: f64::INFINITY,
            steady_s: f64::INFINITY,
        }
    }

    /// Adds the arrival of a frame with device time `device_us` at host time `host_s`.
    pub fn arrived(&mut self, device_us: u64, host_s: f64) {
        if device_us < self.last_device_us {
            // The device was restarted with a new clock.
            self.forget();
        }
        self.last_device_us = device_us;
        if host_s - self.half_began_s > self.half_window_s {
            let gap = host_s - self.half_began_s > 2.0 * self.half_window_s;
            self.least_before = if gap { f64::INFINITY } else { self.least_now };
            self.least_now = f64::INFINITY;
            self.half_began_s = host_s;
            // A slow drift of the clocks is no backlog.
            self.steady_least = self.least_before;
        }
        let offset_s = host_s - device_us as f64 * 1e-6;
        if offset_s < self.steady_least - FALL_PERIODS * self.period_s {
            self.steady_least = offset_s;
            self.steady_s = host_s + STEADY_PERIODS * self.period_s;
        }
        self.least_now = self.least_now.min(offset_s);
        self.last_host_s = host_s;
    }

    fn least(&self) -> f64 {
        self.least_now.min(self.least_before)
    }

    /// Host time of the first sample of a frame, never later than the true time; `None` before
    /// frames have arrived for some periods at their pace.
    pub fn sampled_s(&self, device_us: u64) -> Option<f64> {
        let is_steady = self.last_host_s >= self.steady_s;
        is_steady.then(|| device_us as f64 * 1e-6 + self.least() - self.lead_s)
    }

    /// Discards the estimate after the wire was reopened.
    pub fn forget(&mut self) {
        self.least_now = f64::INFINITY;
        self.least_before = f64::INFINITY;
        self.half_began_s = f64::NEG_INFINITY;
        self.steady_least = f64::INFINITY;
        self.steady_s = f64::INFINITY;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const PERIOD_S: f64 = 1.0 / 30.0;

    /// A device whose clock started 100 s before that of the host; frames are sent after their last
    /// sample and then delayed.
    fn feed(timing: &mut DeviceTiming, frame: u64, delay_s: f64) -> u64 {
        let sampled_s = frame as f64 * PERIOD_S;
        let device_us = ((sampled_s + 100.0) * 1e6) as u64;
        timing.arrived(device_us, sampled_s + PERIOD_S + delay_s);
        device_us
    }

    #[test]
    fn a_frame_that_waited_in_a_buffer_is_known_to_be_old() {
        let mut timing = DeviceTiming::new(PERIOD_S, 0.0, 1.0);
        for n in 0..30 {
            feed(&mut timing, n, 0.001 + 0.002 * (n % 5) as f64);
        }
        let late = feed(&mut timing, 30, 2.0);
        let sampled = timing.sampled_s(late).unwrap();
        assert!((sampled - 1.0).abs() < 0.002, "{sampled}");
    }

    #[test]
    fn the_estimate_is_never_later_than_the_truth_if_latency_has_its_margin() {
        let mut timing = DeviceTiming::new(PERIOD_S, 0.017, 1.0);
        for n in 0..1000 {
            let latency = 0.017 + 0.0002 + 0.01 * ((n * 7919) % 13) as f64 / 13.0;
            let device = feed(&mut timing, n, latency);
            let truth = n as f64 * PERIOD_S;
            let Some(sampled) = timing.sampled_s(device) else {
                assert!(n < 18, "{n}: no estimate");
                continue;
            };
            assert!(sampled <= truth + 1e-6 || n < 13, "{n}: {sampled} > {truth}");
            assert!(sampled > truth - 0.02, "{n}: {sampled} far before {truth}");
        }
    }

    #[test]
    fn a_slow_drift_of_the_clocks_is_followed() {
        let mut timing = DeviceTiming::new(PERIOD_S, 0.0, 1.0);
        let mut last = (0.0, 0);
        for n in 0..30_000_u64 {
            let truth = n as f64 * PERIOD_S;
            let device_us = (truth * (1.0 - 50e-6) * 1e6) as u64;
            timing.arrived(device_us, truth + PERIOD_S + 0.0005);
            last = (truth, device_us);
        }
        let error = timing.sampled_s(last.1).unwrap() - last.0;
        assert!(error.abs() < 0.001, "{error}");
    }

    #[test]
    fn a_device_switched_on_again_starts_a_new_estimate() {
        let mut timing = DeviceTiming::new(PERIOD_S, 0.0, 1.0);
        timing.arrived(900_000_000, 5.0);
        for n in 0..6 {
            assert_eq!(timing.sampled_s(0), None, "frame {n}");
            timing.arrived(n * 40_000, 6.0 + 0.04 * n as f64);
        }
        assert!((timing.sampled_s(0).unwrap() - (6.0 - PERIOD_S)).abs() < 0.001);
        timing.forget();
        assert_eq!(timing.sampled_s(0), None);
    }

    #[test]
    fn frames_that_waited_while_the_wire_was_closed_are_not_new() {
        let mut timing = DeviceTiming::new(PERIOD_S, 0.0, 1.0);
        // Sixty frames in 60 ms at 3 s, the last of them sampled 1 s before.
        let opened_s = 3.0;
        for n in 0..60_u64 {
            timing.arrived((n as f64 * PERIOD_S * 1e6) as u64, opened_s + 0.001 * n as f64);
            assert_eq!(timing.sampled_s(0), None, "frame {n}");
        }
        // New ones at their pace.
        for n in 92..110 {
            let device_us = (n as f64 * PERIOD_S * 1e6) as u64;
            let truth = n as f64 * PERIOD_S;
            timing.arrived(device_us, truth + PERIOD_S + 0.0005);
            let sampled = timing.sampled_s(device_us);
            assert!(n < 98 || (sampled.unwrap() - truth).abs() < 0.001, "{n}: {sampled:?} {truth}");
            assert!(sampled.is_none_or(|s| s <= truth + 0.001), "{n}: {sampled:?} after {truth}");
        }
    }
}
