//! Modbus on the side of a device: requests in, replies or exceptions out, and the two framings.
//! Written from the Modbus application protocol (V1.1b3), sharing nothing with the service.
//! PURE in this file. Never: meanings of registers (`device` has those).

pub mod rtu;
pub mod tcp;

/// Largest number of registers in one read (6.3).
const READ_MAX: u16 = 125;
/// Largest number of registers in one write (6.12).
const WRITE_MAX: u16 = 123;
/// Largest number of bits in one read (6.1).
const BITS_MAX: u16 = 2000;

/// Refusal of a request by a device, with its code on the wire (7).
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Exception {
    /// 1: the device does not have this function.
    IllegalFunction,
    /// 2: the device does not have this address.
    IllegalAddress,
    /// 3: the device does not accept this value or count.
    IllegalValue,
    /// 4: the device failed to execute the request.
    DeviceFailure,
    /// 11: no device has this address behind the gateway.
    NoTarget,
    /// Any code, requested by a fault script.
    Scripted(u8),
}

impl Exception {
    /// Code on the wire.
    pub fn code(self) -> u8 {
        match self {
            Exception::IllegalFunction => 1,
            Exception::IllegalAddress => 2,
            Exception::IllegalValue => 3,
            Exception::DeviceFailure => 4,
            Exception::NoTarget => 11,
            Exception::Scripted(code) => code,
        }
    }
}

/// A request that is valid Modbus; whether the device supports it is decided by the device.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Request {
    /// Functions 1 and 2: read bits.
    ReadBits {
        /// Function: 1 coils, 2 discrete inputs.
        function: u8,
        /// Address of the first bit.
        address: u16,
        /// Number of bits.
        count: u16,
    },
    /// Functions 3 and 4: read registers.
    ReadRegisters {
        /// Function: 3 holding registers, 4 input registers.
        function: u8,
        /// Address of the first register.
        address: u16,
        /// Number of registers.
        count: u16,
    },
    /// Function 5: write one coil.
    WriteCoil {
        /// Address of the coil.
        address: u16,
        /// FF00 if on, 0000 if off.
        on: bool,
    },
    /// Function 6: write one register.
    WriteRegister {
        /// Address of the register.
        address: u16,
        /// Value that is written.
        value: u16,
    },
    /// Function 16: write a block of registers.
    WriteRegisters {
        /// Address of the first register.
        address: u16,
        /// Values that are written, one per register.
        values: Vec<u16>,
    },
}

/// Reply of a device.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Reply {
    /// Reply to functions 1 and 2.
    Bits(Vec<bool>),
    /// Reply to functions 3 and 4.
    Registers(Vec<u16>),
    /// Reply to a write.
    Written,
}

fn word(bytes: &[u8], at: usize) -> Option<u16> {
    Some(u16::from_be_bytes([*bytes.get(at)?, *bytes.get(at + 1)?]))
}

impl Request {
    /// Parses a protocol data unit: function code and data.
    ///
    /// # Errors
    /// `IllegalFunction` for an unknown function, `IllegalValue` for an invalid length, count or
    /// value.
    pub fn parse(pdu: &[u8]) -> Result<Self, Exception> {
        let function = *pdu.first().ok_or(Exception::IllegalFunction)?;
        if !matches!(function, 1..=6 | 16) {
            return Err(Exception::IllegalFunction);
        }
        let address = word(pdu, 1).ok_or(Exception::IllegalValue)?;
        let second = word(pdu, 3).ok_or(Exception::IllegalValue)?;
        match function {
            1 | 2 if (1..=BITS_MAX).contains(&second) => {
                Ok(Request::ReadBits { function, address, count: second })
            }
            3 | 4 if (1..=READ_MAX).contains(&second) => {
                Ok(Request::ReadRegisters { function, address, count: second })
            }
            5 if second == 0xFF00 || second == 0 => {
                Ok(Request::WriteCoil { address, on: second != 0 })
            }
            6 => Ok(Request::WriteRegister { address, value: second }),
            16 if (1..=WRITE_MAX).contains(&second) => {
                let data = pdu.get(6..).ok_or(Exception::IllegalValue)?;
                let bytes = usize::from(second) * 2;
                if usize::from(pdu[5]) != bytes || data.len() != bytes {
                    return Err(Exception::IllegalValue);
                }
                let values = data.chunks(2).map(|b| u16::from_be_bytes([b[0], b[1]])).collect();
                Ok(Request::WriteRegisters { address, values })
            }
            _ => Err(Exception::IllegalValue),
        }
    }

    /// Whether the request changes the device.
    pub fn writes(&self) -> bool {
        !matches!(self, Request::ReadBits { .. } | Request::ReadRegisters { .. })
    }
}

/// Encodes the protocol data unit that answers `request_pdu`.
pub fn answer(request_pdu: &[u8], outcome: &Result<Reply, Exception>) -> Vec<u8> {
    let function = request_pdu.first().copied().unwrap_or(0);
    match outcome {
        Ok(Reply::Registers(values)) => {
            let mut pdu = vec![function, (values.len() * 2) as u8];
            pdu.extend(values.iter().flat_map(|v| v.to_be_bytes()));
            pdu
        }
        Ok(Reply::Bits(bits)) => {
            let mut pdu = vec![function, bits.len().div_ceil(8) as u8];
            for eight in bits.chunks(8) {
                pdu.push(eight.iter().enumerate().fold(0, |b, (i, &on)| b | u8::from(on) << i));
            }
            pdu
        }
        Ok(Reply::Written) => request_pdu.get(..5).unwrap_or(request_pdu).to_vec(),
        Err(exception) => vec![function | 0x80, exception.code()],
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_specification_s_own_examples() {
        // 6.3: read holding registers 108 to 110.
        let pdu = [0x03, 0x00, 0x6B, 0x00, 0x03];
        let read = Request::ReadRegisters { function: 3, address: 0x6B, count: 3 };
        assert_eq!(Request::parse(&pdu), Ok(read));
        let reply = answer(&pdu, &Ok(Reply::Registers(vec![0x022B, 0, 0x64])));
        assert_eq!(reply, [0x03, 0x06, 0x02, 0x2B, 0x00, 0x00, 0x00, 0x64]);
        // 6.12: write two registers.
        let pdu = [0x10, 0x00, 0x01, 0x00, 0x02, 0x04, 0x00, 0x0A, 0x01, 0x02];
        let write = Request::WriteRegisters { address: 1, values: vec![0x0A, 0x0102] };
        assert_eq!(Request::parse(&pdu), Ok(write));
        assert_eq!(answer(&pdu, &Ok(Reply::Written)), [0x10, 0x00, 0x01, 0x00, 0x02]);
    }

    #[test]
    fn bits_are_packed_from_the_lowest() {
        let bits = vec![true, false, true, true, false, false, true, true, true];
        assert_eq!(answer(&[1, 0, 0, 0, 9], &Ok(Reply::Bits(bits))), [1, 2, 0xCD, 0x01]);
    }

    #[test]
    fn nonsense_is_refused_with_the_right_code() {
        let value = Err(Exception::IllegalValue);
        assert_eq!(Request::parse(&[0x2B, 0x0E, 1, 0]), Err(Exception::IllegalFunction));
        assert_eq!(Request::parse(&[3, 0, 0, 0, 0]), value);
        assert_eq!(Request::parse(&[3, 0, 0, 0, 126]), value);
        assert_eq!(Request::parse(&[5, 4, 3, 0x12, 0x34]), value);
        assert_eq!(Request::parse(&[16, 0, 1, 0, 2, 4, 0, 1]), value);
        assert_eq!(Request::parse(&[3, 0]), value);
        assert_eq!(answer(&[3, 0, 0, 0, 126], &value.map(|_: Request| Reply::Written)), [0x83, 3]);
    }
}
