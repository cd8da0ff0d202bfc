//! The five Modbus functions that the supported devices use, and the valid replies to each.
//! PURE. Uses: tokio-modbus (its form of them). Never: ports, addresses of devices, meanings of registers.

/// A request to a device.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Request {
    /// Function 3: holding registers.
    ReadHolding {
        /// Address of the first register.
        address: u16,
        /// Number of registers.
        count: u16,
    },
    /// Function 4: input registers.
    ReadInput {
        /// Address of the first register.
        address: u16,
        /// Number of registers.
        count: u16,
    },
    /// Function 5: one coil.
    WriteCoil {
        /// Address of the coil.
        address: u16,
        /// FF00 if on, 0000 if off.
        on: bool,
    },
    /// Function 6: one holding register.
    WriteRegister {
        /// Address of the register.
        address: u16,
        /// New value of the register.
        word: u16,
    },
    /// Function 16: a block of holding registers.
    WriteRegisters {
        /// Address of the first register.
        address: u16,
        /// New values, from the first register.
        words: Vec<u16>,
    },
}

/// Reply of a device.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Reply {
    /// Values of the registers that were read.
    Words(Vec<u16>),
    /// Echo of a coil that was written.
    Coil {
        /// Address of the coil.
        address: u16,
        /// Value that was written.
        on: bool,
    },
    /// Echo of a register that was written.
    Register {
        /// Address of the register.
        address: u16,
        /// Value that was written.
        word: u16,
    },
    /// Echo of a block that was written.
    Registers {
        /// Address of the first register.
        address: u16,
        /// Number of registers.
        count: u16,
    },
    /// Reply to another function.
    Foreign,
}

impl Request {
    /// Whether a reply to the other request would be taken for one to this: a read does not return its address.
    pub(super) fn is_alike(&self, other: &Self) -> bool {
        match (self, other) {
            (Request::ReadHolding { count, .. }, Request::ReadHolding { count: c, .. })
            | (Request::ReadInput { count, .. }, Request::ReadInput { count: c, .. }) => count == c,
            (
                Request::WriteRegisters { address, words },
                Request::WriteRegisters { address: a, words: w },
            ) => address == a && words.len() == w.len(),
            _ => self == other,
        }
    }

    /// Checks that the reply answers this request: the length of a read, the echo of a write.
    ///
    /// # Errors
    /// A message with the reply and the request if it does not.
    pub fn accepts(&self, reply: &Reply) -> Result<(), String> {
        let sound = match (self, reply) {
            (
                Request::ReadHolding { count, .. } | Request::ReadInput { count, .. },
                Reply::Words(words),
            ) => words.len() == usize::from(*count),
            (Request::WriteCoil { address, on }, Reply::Coil { address: a, on: o }) => {
                (address, on) == (a, o)
            }
            (Request::WriteRegister { address, word }, Reply::Register { address: a, word: w }) => {
                (address, word) == (a, w)
            }
            (
                Request::WriteRegisters { address, words },
                Reply::Registers { address: a, count },
            ) => address == a && words.len() == usize::from(*count),
            _ => false,
        };
        if sound { Ok(()) } else { Err(format!("{reply} does not answer {self}")) }
    }
}

impl std::fmt::Display for Reply {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Reply::Words(words) => write!(f, "values {words:?}"),
            Reply::Coil { address, on } => {
                write!(f, "echo of coil 0x{address:04X} {}", if *on { "on" } else { "off" })
            }
            Reply::Register { address, word } => {
                write!(f, "echo of 0x{word:04X} at 0x{address:04X}")
            }
            Reply::Registers { address, count } => write!(f, "echo of {count} at 0x{address:04X}"),
            Reply::Foreign => f.write_str("reply to another function"),
        }
    }
}

impl std::fmt::Display for Request {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Request::ReadHolding { address, count } | Request::ReadInput { address, count } => {
                write!(f, "read of {count} at 0x{address:04X}")
            }
            Request::WriteCoil { address, on } => {
                write!(f, "coil 0x{address:04X} {}", if *on { "on" } else { "off" })
            }
            Request::WriteRegister { address, word } => {
                write!(f, "write of 0x{word:04X} to 0x{address:04X}")
            }
            Request::WriteRegisters { address, words } => {
                write!(f, "write of {} at 0x{address:04X}", words.len())
            }
        }
    }
}

/// A request as the library sends it.
pub(super) fn to_wire(request: &Request) -> tokio_modbus::Request<'_> {
    use tokio_modbus::Request as Pdu;
    match request {
        Request::ReadHolding { address, count } => Pdu::ReadHoldingRegisters(*address, *count),
        Request::ReadInput { address, count } => Pdu::ReadInputRegisters(*address, *count),
        Request::WriteCoil { address, on } => Pdu::WriteSingleCoil(*address, *on),
        Request::WriteRegister { address, word } => Pdu::WriteSingleRegister(*address, *word),
        Request::WriteRegisters { address, words } => {
            Pdu::WriteMultipleRegisters(*address, words.as_slice().into())
        }
    }
}

/// A reply as the library has received it.
pub(super) fn reply_of(response: tokio_modbus::Response) -> Reply {
    use tokio_modbus::Response as Pdu;
    match response {
        Pdu::ReadHoldingRegisters(words) | Pdu::ReadInputRegisters(words) => Reply::Words(words),
        Pdu::WriteSingleCoil(address, on) => Reply::Coil { address, on },
        Pdu::WriteSingleRegister(address, word) => Reply::Register { address, word },
        Pdu::WriteMultipleRegisters(address, count) => Reply::Registers { address, count },
        _ => Reply::Foreign,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn requests_whose_replies_look_the_same_are_alike() {
        let read = |address, count| Request::ReadHolding { address, count };
        assert!(read(0x9000, 2).is_alike(&read(0x9100, 2)));
        assert!(!read(0x9000, 2).is_alike(&read(0x9000, 3)));
        assert!(!read(0x9000, 2).is_alike(&Request::ReadInput { address: 0x9000, count: 2 }));
        let block = |word| Request::WriteRegisters { address: 0x9900, words: vec![word; 9] };
        assert!(block(1).is_alike(&block(2)));
        let coil = |on| Request::WriteCoil { address: 0x040A, on };
        assert!(coil(true).is_alike(&coil(true)) && !coil(true).is_alike(&coil(false)));
    }

    #[test]
    fn only_the_echo_of_a_write_and_the_right_length_of_a_read_answer_it() {
        let read = Request::ReadHolding { address: 0x9000, count: 2 };
        assert!(read.accepts(&Reply::Words(vec![0, 1])).is_ok());
        assert!(read.accepts(&Reply::Words(vec![0])).is_err());
        assert!(read.accepts(&Reply::Foreign).is_err());
        let coil = Request::WriteCoil { address: 0x040A, on: true };
        assert!(coil.accepts(&Reply::Coil { address: 0x040A, on: true }).is_ok());
        assert!(coil.accepts(&Reply::Coil { address: 0x040A, on: false }).is_err());
        let block = Request::WriteRegisters { address: 0x9900, words: vec![0; 9] };
        assert!(block.accepts(&Reply::Registers { address: 0x9900, count: 9 }).is_ok());
        let words = block.accepts(&Reply::Registers { address: 0x9900, count: 8 }).unwrap_err();
        assert_eq!(words, "echo of 8 at 0x9900 does not answer write of 9 at 0x9900");
    }
}
