//! Modbus RTU framing (Serial Line V1.02, 2.5.1): address, data, CRC16 with its low byte first.
//! A pseudo-terminal has no character times, so the function of a frame determines its end.
//! PURE. Never: ports.

/// Length of the shortest frame: address, function, CRC.
const SHORTEST: usize = 4;

/// One request as received.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Adu {
    /// Address of the device; 0 is a broadcast, which is not answered.
    pub unit: u8,
    /// Function code and data.
    pub pdu: Vec<u8>,
}

/// State of the line after the bytes in the buffer.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum LineState {
    /// Bytes have just arrived, and more may follow.
    Receiving,
    /// No bytes have arrived for a while, so the buffer contains the whole frame.
    Silent,
}

/// Content of the front of the buffer.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Taken {
    /// The frame is incomplete.
    Incomplete,
    /// A request with a valid checksum.
    Request(Adu),
    /// A complete frame with an invalid checksum: a device does not reply and waits for silence.
    Garbled,
}

/// CRC16 of a frame (polynomial A001, start FFFF).
pub fn crc16(bytes: &[u8]) -> u16 {
    bytes.iter().fold(0xFFFF, |crc, &byte| {
        (0..8).fold(crc ^ u16::from(byte), |c, _| if c & 1 == 1 { c >> 1 ^ 0xA001 } else { c >> 1 })
    })
}

/// Length of the request at the front, if its function determines it. With an unknown function the
/// whole buffer is one frame once the line is silent.
fn request_length(buffer: &[u8], line: LineState) -> Option<usize> {
    match buffer.get(1)? {
        1..=6 => Some(8),
        15 | 16 => Some(9 + usize::from(*buffer.get(6)?)),
        22 => Some(10),
        23 => Some(13 + usize::from(*buffer.get(10)?)),
        _ => (line == LineState::Silent).then_some(buffer.len()),
    }
}

/// Takes one request from the front.
pub fn take(buffer: &mut Vec<u8>, line: LineState) -> Taken {
    let length = request_length(buffer, line).unwrap_or(usize::MAX);
    if buffer.len() < length.max(SHORTEST) {
        if line == LineState::Silent && !buffer.is_empty() {
            buffer.clear();
            return Taken::Garbled;
        }
        return Taken::Incomplete;
    }
    let body = length - 2;
    let sent = u16::from_le_bytes([buffer[body], buffer[body + 1]]);
    if crc16(&buffer[..body]) != sent {
        buffer.clear();
        return Taken::Garbled;
    }
    let adu = Adu { unit: buffer[0], pdu: buffer[1..body].to_vec() };
    buffer.drain(..length);
    Taken::Request(adu)
}

/// Frames a reply.
pub fn frame(unit: u8, pdu: &[u8]) -> Vec<u8> {
    let mut bytes = Vec::with_capacity(pdu.len() + 3);
    bytes.push(unit);
    bytes.extend(pdu);
    bytes.extend(crc16(&bytes).to_le_bytes());
    bytes
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Documented request of Waveshare for all eight channels.
    const WAVESHARE: [u8; 8] = [0x01, 0x04, 0x00, 0x00, 0x00, 0x08, 0xF1, 0xCC];

    #[test]
    fn a_documented_frame_is_read_and_written() {
        let mut buffer = WAVESHARE.to_vec();
        let adu = Adu { unit: 1, pdu: WAVESHARE[1..6].to_vec() };
        assert_eq!(take(&mut buffer, LineState::Receiving), Taken::Request(adu));
        assert!(buffer.is_empty());
        assert_eq!(frame(1, &WAVESHARE[1..6]), WAVESHARE);
    }

    #[test]
    fn every_flipped_bit_is_noticed() {
        for bit in 0..64 {
            let mut buffer = WAVESHARE.to_vec();
            buffer[bit / 8] ^= 1 << (bit % 8);
            let taken = take(&mut buffer, LineState::Silent);
            assert_eq!(taken, Taken::Garbled, "bit {bit}");
        }
    }

    #[test]
    fn a_cut_frame_waits_and_then_is_dropped() {
        let mut buffer = WAVESHARE[..5].to_vec();
        assert_eq!(take(&mut buffer, LineState::Receiving), Taken::Incomplete);
        assert_eq!(take(&mut buffer, LineState::Silent), Taken::Garbled);
        assert!(buffer.is_empty());
    }
}
