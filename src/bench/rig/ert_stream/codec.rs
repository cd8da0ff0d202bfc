//! Packets of the voltage stream, decoded from bytes that may be lost, doubled or flipped.
//! PURE. Uses: cobs, crc32fast. Never: ports, clocks.
//!
//! Packet (`docs/references.md`, "ERT stream packets"), little-endian, COBS-coded, ended by 0x00:
//! `u8 version = 1, u8 kind = 1, u16 electrodes, u32 sequence, u64 device_time_us,
//! f32 volts_per_count, i16 counts[electrodes^2], u32 crc32` (IEEE, over all before it).
//! Kind 2 is a line of text between version, kind and the checksum.
//! A damaged packet is dropped completely; decoding resumes after the next zero.

/// Version of the packet layout.
const PACKET_VERSION: u8 = 1;
/// Kind of a packet with a frame of voltages.
const KIND_FRAME: u8 = 1;
/// Kind of a packet with a line of text.
const KIND_STATUS: u8 = 2;
/// Length of the header before the counts, bytes.
const PACKET_HEADER: usize = 20;
/// Length of the checksum, bytes.
const CHECKSUM: usize = 4;
/// Longest stored line of text, characters.
const STATUS_LENGTH: usize = 256;

/// A frame with the values of its packet.
#[derive(Debug, Clone, PartialEq)]
pub struct RawFrame {
    /// Sequence number from the device.
    pub sequence: u32,
    /// Device time of the first sample, microseconds.
    pub device_time_us: u64,
    /// Voltage of one count, V.
    pub volts_per_count: f32,
    /// Counts, injection-major, electrodes squared.
    pub counts: Vec<i16>,
}

/// Content of a decoded packet.
#[derive(Debug, Clone, PartialEq)]
pub enum Event {
    /// A valid frame.
    Frame(RawFrame),
    /// A line of text from the device.
    Status(String),
}

/// Counters since the decoder was created.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Tally {
    /// Number of valid frames.
    pub frames: u64,
    /// Number of frames missing according to the sequence numbers.
    pub missed: u64,
    /// Number of packets with a wrong code, length, version, electrode count, scale or checksum.
    pub garbled: u64,
    /// Number of restarts of the device according to the sequence numbers.
    pub restarts: u64,
}

/// Splits a byte stream into packets. The result does not depend on how the bytes are portioned.
#[derive(Debug)]
pub struct Decoder {
    electrodes: u16,
    packet: Vec<u8>,
    limit: usize,
    overflowing: bool,
    /// Whether a zero has been received, so that the next packet is complete.
    in_step: bool,
    last_sequence: Option<u32>,
    tally: Tally,
}

impl Decoder {
    /// Creates a decoder for frames of `electrodes` squared counts.
    pub fn new(electrodes: u16) -> Self {
        let plain = PACKET_HEADER + 2 * usize::from(electrodes).pow(2) + CHECKSUM;
        let limit = cobs::max_encoding_length(plain.max(STATUS_LENGTH + PACKET_HEADER));
        Self {
            electrodes,
            packet: Vec::with_capacity(limit),
            limit,
            overflowing: false,
            in_step: false,
            last_sequence: None,
            tally: Tally::default(),
        }
    }

    /// Returns the counters.
    pub fn tally(&self) -> Tally {
        self.tally
    }

    /// Resets the decoder after the wire was reopened: a partial packet is dropped, and the first
    /// packet may be cut.
    pub fn reopen(&mut self) {
        self.packet.clear();
        self.overflowing = false;
        self.in_step = false;
    }

    /// Decodes the next bytes and emits the packets that they complete.
    pub fn push(&mut self, mut bytes: &[u8], mut emit: impl FnMut(Event)) {
        while let Some(end) = bytes.iter().position(|&b| b == 0) {
            self.keep(&bytes[..end]);
            self.finish(&mut emit);
            bytes = &bytes[end + 1..];
        }
        self.keep(bytes);
    }

    fn keep(&mut self, bytes: &[u8]) {
        if self.overflowing || self.packet.len() + bytes.len() > self.limit {
            self.packet.clear();
            self.overflowing = true;
        } else {
            self.packet.extend_from_slice(bytes);
        }
    }

    fn finish(&mut self, emit: &mut impl FnMut(Event)) {
        let empty = self.packet.is_empty() && !self.overflowing;
        let event = match cobs::decode_in_place(&mut self.packet) {
            Ok(length) if !self.overflowing => parse(&self.packet[..length], self.electrodes),
            _ => None,
        };
        match event {
            Some(Event::Frame(frame)) => self.accept(frame, emit),
            Some(status) => emit(status),
            None if empty => {}
            None => self.tally.garbled += u64::from(self.in_step),
        }
        self.packet.clear();
        self.overflowing = false;
        self.in_step = true;
    }

    fn accept(&mut self, frame: RawFrame, emit: &mut impl FnMut(Event)) {
        let step = self.last_sequence.map_or(1, |last| frame.sequence.wrapping_sub(last));
        if step == 0 {
            self.tally.garbled += 1;
            return;
        }
        // A lower number means that the device was restarted; nothing is missing then.
        if step < u32::MAX / 2 {
            self.tally.missed += u64::from(step - 1);
        } else {
            self.tally.restarts += 1;
        }
        self.last_sequence = Some(frame.sequence);
        self.tally.frames += 1;
        emit(Event::Frame(frame));
    }
}

/// Content of a decoded packet; `None` if any part of it is invalid.
fn parse(packet: &[u8], electrodes: u16) -> Option<Event> {
    let (body, checksum) = packet.split_last_chunk::<CHECKSUM>()?;
    if crc32fast::hash(body) != u32::from_le_bytes(*checksum) || *body.first()? != PACKET_VERSION {
        return None;
    }
    match *body.get(1)? {
        KIND_FRAME => parse_frame(body, electrodes),
        KIND_STATUS => {
            let text = String::from_utf8_lossy(&body[2..]);
            let plain = text.chars().filter(|c| !c.is_control() && *c != '\u{FFFD}');
            Some(Event::Status(plain.take(STATUS_LENGTH).collect()))
        }
        _ => None,
    }
}

fn parse_frame(body: &[u8], electrodes: u16) -> Option<Event> {
    let (header, counts) = body.split_first_chunk::<PACKET_HEADER>()?;
    let [_, _, e0, e1, s0, s1, s2, s3, t0, t1, t2, t3, t4, t5, t6, t7, v0, v1, v2, v3] = *header;
    let volts_per_count = f32::from_le_bytes([v0, v1, v2, v3]);
    let sound = u16::from_le_bytes([e0, e1]) == electrodes
        && counts.len() == 2 * usize::from(electrodes).pow(2)
        && volts_per_count.is_finite()
        && volts_per_count > 0.0;
    let (counts, _) = counts.as_chunks::<2>();
    sound.then(|| {
        Event::Frame(RawFrame {
            sequence: u32::from_le_bytes([s0, s1, s2, s3]),
            device_time_us: u64::from_le_bytes([t0, t1, t2, t3, t4, t5, t6, t7]),
            volts_per_count,
            counts: counts.iter().map(|&c| i16::from_le_bytes(c)).collect(),
        })
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn packet(kind: u8, rest: &[u8]) -> Vec<u8> {
        let mut plain = vec![1, kind];
        plain.extend_from_slice(rest);
        plain.extend_from_slice(&crc32fast::hash(&plain).to_le_bytes());
        let mut coded = cobs::encode_vec(&plain);
        coded.push(0);
        coded
    }

    fn frame(electrodes: u16, sequence: u32) -> Vec<u8> {
        let mut rest = electrodes.to_le_bytes().to_vec();
        rest.extend_from_slice(&sequence.to_le_bytes());
        rest.extend_from_slice(&(1000 * u64::from(sequence)).to_le_bytes());
        rest.extend_from_slice(&0.001_f32.to_le_bytes());
        for i in 0..electrodes * electrodes {
            rest.extend_from_slice(&(i as i16 - 8 + sequence as i16).to_le_bytes());
        }
        packet(1, &rest)
    }

    fn decode(decoder: &mut Decoder, bytes: &[u8]) -> Vec<Event> {
        let mut events = Vec::new();
        decoder.push(bytes, |e| events.push(e));
        events
    }

    fn sequences(events: &[Event]) -> Vec<u32> {
        let frames = events.iter().filter_map(|e| match e {
            Event::Frame(f) => Some(f.sequence),
            Event::Status(_) => None,
        });
        frames.collect()
    }

    #[test]
    fn a_frame_comes_out_as_it_was_packed() {
        let mut decoder = Decoder::new(28);
        let events = decode(&mut decoder, &frame(28, 7));
        let [Event::Frame(f)] = events.as_slice() else { panic!("{events:?}") };
        assert_eq!((f.sequence, f.device_time_us, f.volts_per_count), (7, 7000, 0.001));
        assert_eq!((f.counts.len(), f.counts[0], f.counts[783]), (784, -1, 782));
        assert_eq!(decoder.tally(), Tally { frames: 1, ..Tally::default() });
    }

    #[test]
    fn a_packet_cut_by_the_opening_is_dropped_without_blame() {
        let mut decoder = Decoder::new(4);
        let bytes = [&frame(4, 1)[20..], &frame(4, 2)[..]].concat();
        assert_eq!(sequences(&decode(&mut decoder, &bytes)), [2]);
        assert_eq!(decoder.tally().garbled, 0);
    }

    #[test]
    fn a_flipped_byte_costs_one_frame_and_the_gap_is_counted() {
        let mut decoder = Decoder::new(4);
        let mut hurt = frame(4, 2);
        hurt[25] ^= 0x10;
        let bytes = [frame(4, 1), hurt, frame(4, 3)].concat();
        assert_eq!(sequences(&decode(&mut decoder, &bytes)), [1, 3]);
        let tally = decoder.tally();
        assert_eq!((tally.frames, tally.missed, tally.garbled), (2, 1, 1));
    }

    #[test]
    fn a_lost_zero_costs_the_two_frames_that_it_parted() {
        let mut decoder = Decoder::new(4);
        let mut second = frame(4, 2);
        second.pop();
        let bytes = [frame(4, 1), second, frame(4, 3), frame(4, 4)].concat();
        assert_eq!(sequences(&decode(&mut decoder, &bytes)), [1, 4]);
        assert_eq!((decoder.tally().missed, decoder.tally().garbled), (2, 1));
    }

    #[test]
    fn an_endless_packet_is_bounded() {
        let mut decoder = Decoder::new(4);
        assert!(decode(&mut decoder, &[0]).is_empty());
        assert!(decode(&mut decoder, &vec![5; 100_000]).is_empty());
        assert!(decoder.packet.capacity() < 1000);
        let bytes = [vec![0], frame(4, 9)].concat();
        assert_eq!(sequences(&decode(&mut decoder, &bytes)), [9]);
        assert_eq!(decoder.tally().garbled, 1);
    }

    #[test]
    fn a_foreign_electrode_count_or_version_or_scale_is_no_frame() {
        let mut decoder = Decoder::new(28);
        decode(&mut decoder, &[0]);
        assert!(decode(&mut decoder, &frame(32, 1)).is_empty());
        let mut rest = 28_u16.to_le_bytes().to_vec();
        rest.extend_from_slice(&[0; 12]);
        rest.extend_from_slice(&f32::NAN.to_le_bytes());
        rest.extend_from_slice(&[0; 2 * 784]);
        assert!(decode(&mut decoder, &packet(1, &rest)).is_empty());
        assert!(decode(&mut decoder, &packet(9, &rest)).is_empty());
        assert_eq!(decoder.tally().garbled, 3);
    }

    #[test]
    fn a_status_line_is_text() {
        let mut decoder = Decoder::new(28);
        let events = decode(&mut decoder, &packet(2, b"ert 1.4 ok\r\n"));
        assert_eq!(events, [Event::Status("ert 1.4 ok".into())]);
    }

    #[test]
    fn a_device_switched_on_again_misses_nothing() {
        let mut decoder = Decoder::new(4);
        let bytes = [frame(4, 5000), frame(4, 0), frame(4, 0)].concat();
        assert_eq!(sequences(&decode(&mut decoder, &bytes)), [5000, 0]);
        let tally = decoder.tally();
        assert_eq!((tally.missed, tally.garbled, tally.restarts), (0, 1, 1));
    }

    #[derive(Debug, Clone)]
    enum Damage {
        Flip(u8),
        Lose,
        Double,
    }

    fn damage() -> impl Strategy<Value = Damage> {
        prop_oneof![(1..=255_u8).prop_map(Damage::Flip), Just(Damage::Lose), Just(Damage::Double)]
    }

    proptest! {
        /// No damage produces a wrong frame, and every frame at least two packets away is decoded.
        #[test]
        fn damage_never_passes_and_costs_little(
            hurts in prop::collection::vec((0..1000_usize, damage()), 0..6),
            portions in prop::collection::vec(1..97_usize, 1..40),
        ) {
            let clean: Vec<Vec<u8>> = (0..16).map(|s| frame(4, s)).collect();
            let length = clean[0].len();
            let mut bytes: Vec<u8> = clean.concat();
            let mut touched = std::collections::BTreeSet::new();
            let mut hurts = hurts;
            hurts.sort_by_key(|(at, _)| std::cmp::Reverse(at % (16 * length)));
            for (at, damage) in hurts {
                let at = at % (16 * length);
                touched.insert(at / length);
                let at = at.min(bytes.len() - 1);
                match damage {
                    Damage::Flip(mask) => bytes[at] ^= mask,
                    Damage::Lose => drop(bytes.remove(at)),
                    Damage::Double => bytes.insert(at, bytes[at]),
                }
            }
            let mut whole = Decoder::new(4);
            let events = decode(&mut whole, &bytes);
            let mut portioned = Decoder::new(4);
            let mut again = Vec::new();
            let mut rest = bytes.as_slice();
            for n in portions.iter().cycle() {
                if rest.is_empty() { break; }
                let (head, tail) = rest.split_at((*n).min(rest.len()));
                again.extend(decode(&mut portioned, head));
                rest = tail;
            }
            prop_assert_eq!(&events, &again);
            prop_assert_eq!(whole.tally(), portioned.tally());
            for event in &events {
                let Event::Frame(f) = event else { continue };
                let mut true_one = Decoder::new(4);
                let expected = decode(&mut true_one, &clean[f.sequence as usize]);
                prop_assert_eq!(std::slice::from_ref(event), expected.as_slice());
            }
            let came = sequences(&events);
            for s in 0..16_usize {
                let clear = !touched.contains(&s) && (s == 0 || !touched.contains(&(s - 1)));
                prop_assert!(!clear || came.contains(&(s as u32)), "frame {} lost", s);
            }
        }
    }
}
