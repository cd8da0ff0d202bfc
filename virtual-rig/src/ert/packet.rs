//! Packets of the voltage stream (`docs/references.md`, "ERT stream packets"): little-endian, a
//! CRC32 over all before it, COBS, a zero at the end.
//! PURE. Uses: crc32fast. Never: sockets, decoding of packets.
//!
//! An accelerated rig sends thousands of frames per second, so a packet must take only
//! microseconds.

/// Version of the packet layout.
const VERSION: u8 = 1;
/// Kind of a packet with a frame.
const KIND_FRAME: u8 = 1;
/// Kind of a packet with a text line.
const KIND_STATUS: u8 = 2;
/// Number of gain steps of the amplifier; each has half the full scale of the previous one.
const GAIN_STEPS: i32 = 8;
/// Largest fraction of a gain step that the signal may use.
const USE: f64 = 0.8;
/// Reserve for noise and drift in addition to the held voltages, V.
const NOISE_ROOM_V: f64 = 0.02;

/// The amplifier before the converter; it chooses the gain step of each frame.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Amplifier {
    /// Full scale of the first gain step, V: the voltage of the source.
    pub source_v: f64,
}

impl Amplifier {
    /// Voltage of one count, V: that of the finest gain step that contains `largest_v`.
    pub fn volts_per_count(&self, largest_v: f64) -> f32 {
        let needed = (largest_v + NOISE_ROOM_V) / USE;
        let steps = (self.source_v / needed).log2().floor().clamp(0.0, f64::from(GAIN_STEPS - 1));
        (self.source_v / 2f64.powf(steps) / f64::from(i16::MAX)) as f32
    }
}

/// Encodes packets, with a reused buffer.
#[derive(Debug, Default)]
pub struct PacketWriter {
    raw: Vec<u8>,
}

impl PacketWriter {
    /// Appends the packet of a frame to `out`. `voltages_v` is injection-major, electrodes squared.
    pub fn frame(
        &mut self,
        sequence: u32,
        device_time_us: u64,
        volts_per_count: f32,
        voltages_v: &[f32],
        out: &mut Vec<u8>,
    ) {
        let electrodes = (voltages_v.len() as f64).sqrt().round() as u16;
        self.raw.clear();
        self.raw.extend([VERSION, KIND_FRAME]);
        self.raw.extend(electrodes.to_le_bytes());
        self.raw.extend(sequence.to_le_bytes());
        self.raw.extend(device_time_us.to_le_bytes());
        self.raw.extend(volts_per_count.to_le_bytes());
        let scale = 1.0 / volts_per_count;
        // A cast of a float to an integer saturates at the ends of its range, as a converter does.
        let count = |v: f32| (v * scale + 0.5f32.copysign(v)) as i16;
        self.raw.extend(voltages_v.iter().flat_map(|&v| count(v).to_le_bytes()));
        self.finish(out);
    }

    /// Appends the packet of a text line to `out`.
    pub fn status(&mut self, text: &str, out: &mut Vec<u8>) {
        self.raw.clear();
        self.raw.extend([VERSION, KIND_STATUS]);
        self.raw.extend(text.as_bytes());
        self.finish(out);
    }

    fn finish(&mut self, out: &mut Vec<u8>) {
        self.raw.extend(crc32fast::hash(&self.raw).to_le_bytes());
        stuff(&self.raw, out);
    }
}

/// Consistent overhead byte stuffing (Cheshire and Baker): every run up to a zero, or of 254 bytes
/// without one, is preceded by its length plus one; a zero ends the packet.
fn stuff(raw: &[u8], out: &mut Vec<u8>) {
    const FULL: usize = 0xFF;
    let start = out.len();
    out.resize(start + raw.len() + raw.len() / (FULL - 1) + 2, 0);
    let to = &mut out[start..];
    let (mut lead, mut at) = (0, 1);
    for (i, &byte) in raw.iter().enumerate() {
        to[at] = byte;
        at += 1;
        let full = at - lead == FULL;
        if byte == 0 {
            // The position of the zero becomes the next length byte.
            to[lead] = (at - 1 - lead) as u8;
            lead = at - 1;
        } else if full && i + 1 < raw.len() {
            to[lead] = FULL as u8;
            lead = at;
            at += 1;
        }
    }
    to[lead] = (at - lead) as u8;
    out.truncate(start + at);
    out.push(0);
}

#[cfg(test)]
mod tests {
    use super::*;

    /// An independent COBS decoder, from Cheshire and Baker's description.
    fn uncobs(bytes: &[u8]) -> Vec<u8> {
        let mut out = Vec::new();
        let mut at = 0;
        while at < bytes.len() {
            let code = usize::from(bytes[at]);
            out.extend(&bytes[at + 1..at + code]);
            at += code;
            if code < 0xFF && at < bytes.len() {
                out.push(0);
            }
        }
        out
    }

    /// CRC32 (IEEE), bit by bit.
    fn crc32(bytes: &[u8]) -> u32 {
        !bytes.iter().fold(u32::MAX, |crc, &b| {
            (0..8).fold(
                crc ^ u32::from(b),
                |c, _| {
                    if c & 1 == 1 { c >> 1 ^ 0xEDB8_8320 } else { c >> 1 }
                },
            )
        })
    }

    #[test]
    fn a_frame_is_laid_out_as_the_contract_says() {
        let voltages: Vec<f32> = (0..784).map(|i| (i as f32 - 392.0) * 1e-3).collect();
        let mut out = Vec::new();
        PacketWriter::default().frame(7, 1_234_567, 0.001, &voltages, &mut out);
        assert_eq!(out.iter().filter(|&&b| b == 0).count(), 1);
        assert_eq!(out.last(), Some(&0));
        let raw = uncobs(&out[..out.len() - 1]);
        assert_eq!(raw.len(), 20 + 2 * 784 + 4);
        assert_eq!(raw[..4], [1, 1, 28, 0]);
        assert_eq!(raw[4..8], 7u32.to_le_bytes());
        assert_eq!(raw[8..16], 1_234_567u64.to_le_bytes());
        assert_eq!(raw[16..20], 0.001f32.to_le_bytes());
        assert_eq!(raw[20..22], (-392i16).to_le_bytes());
        assert_eq!(raw[1588..], crc32(&raw[..1588]).to_le_bytes());
    }

    #[test]
    fn stuffing_is_undone_at_every_length_of_run() {
        let stuffed = |raw: &[u8]| {
            let mut out = Vec::new();
            stuff(raw, &mut out);
            out
        };
        assert_eq!(stuffed(&[0x11, 0, 0, 0]), [2, 0x11, 1, 1, 1, 0]);
        assert_eq!(stuffed(&[]), [1, 0]);
        for length in [1, 253, 254, 255, 508, 509, 600] {
            for zero_every in [2, 100, 254, 255, 1000] {
                let raw: Vec<u8> = (1..=length).map(|i| u8::from(i % zero_every != 0)).collect();
                let out = stuffed(&raw);
                assert_eq!(out.iter().position(|&b| b == 0), Some(out.len() - 1));
                assert_eq!(uncobs(&out[..out.len() - 1]), raw, "{length}, {zero_every}");
                assert!(out.len() <= raw.len() + raw.len() / 254 + 2);
            }
        }
    }

    #[test]
    fn a_status_line_is_text_between_kind_and_checksum() {
        let mut out = Vec::new();
        PacketWriter::default().status("ok", &mut out);
        let raw = uncobs(&out[..out.len() - 1]);
        assert_eq!(raw[..4], [1, 2, b'o', b'k']);
        assert_eq!(raw[4..], crc32(&raw[..4]).to_le_bytes());
    }

    #[test]
    fn the_amplifier_never_saturates_on_the_held_voltages() {
        let amplifier = Amplifier { source_v: 12.0 };
        for largest in [0.0, 0.01, 0.1, 0.5, 2.0, 9.0] {
            let step = f64::from(amplifier.volts_per_count(largest)) * 32767.0;
            assert!(step > largest && step <= 12.001, "{step} for {largest}");
        }
        assert!(amplifier.volts_per_count(0.0) < amplifier.volts_per_count(1.0));
    }
}
