"""An ADAM-6017 served by pymodbus, for a driver to be tested against a server we did not write.

Input registers 0..7: the channels, 0..65535 over the range (0-5 V). Holding registers 200..207:
type codes; 210: the model. Prints the port it listens at, and ends when its input closes.
"""

import asyncio
import sys

from pymodbus.datastore import (
    ModbusDeviceContext,
    ModbusSequentialDataBlock,
    ModbusServerContext,
)
from pymodbus.server import ModbusTcpServer

VOLTS = [0.5, 0.75, 1.0, 2.5, 4.0, 4.5, 0.0, 5.0]


async def main() -> None:
    """Serve until standard input closes."""
    raw = [round(v / 5.0 * 65535) for v in VOLTS]
    # Blocks count from 1 where the wire counts from 0.
    holding = [0] * 211
    holding[200:208] = [0x0147] * 8
    holding[210] = 0x6017
    device = ModbusDeviceContext(
        ir=ModbusSequentialDataBlock(1, raw), hr=ModbusSequentialDataBlock(1, holding)
    )
    context = ModbusServerContext(devices=device, single=True)
    server = ModbusTcpServer(context, address=("127.0.0.1", 0))
    await server.serve_forever(background=True)
    print(server.transport.sockets[0].getsockname()[1], flush=True)
    await asyncio.get_running_loop().run_in_executor(None, sys.stdin.read)


asyncio.run(main())
