//! Modbus TCP framing (Messaging Implementation Guide V1.0b, 3.1.3): the MBAP header.
//! PURE. Never: sockets.

/// Length of the header, bytes: transaction, protocol, length, unit.
pub const HEADER: usize = 7;
/// Largest protocol data unit, bytes.
const PDU_MAX: usize = 253;

/// One request as received.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Adu {
    /// Transaction identifier, repeated in the reply.
    pub transaction: u16,
    /// Address of the unit.
    pub unit: u8,
    /// Function code and data.
    pub pdu: Vec<u8>,
}

/// The bytes on the wire are not Modbus TCP; the connection must be closed.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[error("not Modbus TCP: protocol {protocol}, length {length}")]
pub struct NotModbus {
    /// Protocol identifier that was found; 0 is Modbus.
    pub protocol: u16,
    /// Length that was found.
    pub length: u16,
}

/// Takes one complete request from the front of `buffer`, if there is one.
///
/// # Errors
/// `NotModbus` if the header is not that of Modbus TCP.
pub fn take(buffer: &mut Vec<u8>) -> Result<Option<Adu>, NotModbus> {
    let Some(header) = buffer.first_chunk::<HEADER>() else { return Ok(None) };
    let protocol = u16::from_be_bytes([header[2], header[3]]);
    let length = u16::from_be_bytes([header[4], header[5]]);
    if protocol != 0 || !(2..=PDU_MAX + 1).contains(&usize::from(length)) {
        return Err(NotModbus { protocol, length });
    }
    let end = HEADER - 1 + usize::from(length);
    if buffer.len() < end {
        return Ok(None);
    }
    let transaction = u16::from_be_bytes([header[0], header[1]]);
    let adu = Adu { transaction, unit: header[6], pdu: buffer[HEADER..end].to_vec() };
    buffer.drain(..end);
    Ok(Some(adu))
}

/// Frames a reply.
pub fn frame(request: &Adu, pdu: &[u8]) -> Vec<u8> {
    let mut bytes = Vec::with_capacity(HEADER + pdu.len());
    bytes.extend(request.transaction.to_be_bytes());
    bytes.extend([0, 0]);
    bytes.extend(((pdu.len() + 1) as u16).to_be_bytes());
    bytes.push(request.unit);
    bytes.extend(pdu);
    bytes
}

#[cfg(test)]
mod tests {
    use super::*;

    const READ: [u8; 12] = [0x15, 0x01, 0, 0, 0, 6, 0xFF, 3, 0, 4, 0, 1];

    #[test]
    fn a_request_is_taken_only_when_whole() {
        let mut buffer = READ[..11].to_vec();
        assert_eq!(take(&mut buffer), Ok(None));
        buffer.push(READ[11]);
        buffer.extend(&READ[..3]);
        let adu = take(&mut buffer).unwrap().unwrap();
        assert_eq!((adu.transaction, adu.unit, adu.pdu.as_slice()), (0x1501, 0xFF, &READ[7..]));
        assert_eq!(buffer, READ[..3]);
        assert_eq!(frame(&adu, &[3, 2, 0, 5]), [0x15, 1, 0, 0, 0, 5, 0xFF, 3, 2, 0, 5]);
    }

    #[test]
    fn another_protocol_is_not_guessed_at() {
        let mut buffer = b"GET / HTTP/1.1\r\n".to_vec();
        assert!(take(&mut buffer).is_err());
    }
}
