"""Brings up a segment with KickCAT, an EtherCAT master of another project, and prints what it saw as JSON.

`python kickcat_master.py INTERFACE [CYCLES]`: from INIT to OP and through so many cycles in one go. KickCAT waits 2 ms for an
information memory, and its slaves' watchdogs expire after 100 ms, both too short on a busy computer: a go that fails is
followed by another from the beginning. Ends with an error if none succeeds; the caller judges all else.
"""

import json
import sys
import time

import kickcat
from kickcat import State

# Longest time for all goes, s.
PATIENCE_S = 120
# Longest wait for one frame, s.
FRAME_S = 0.02
# Longest wait for a state, s.
STATE_S = 5.0
VENDOR = 0x1018, 1


def vendor(bus, slave):
    """Vendor that the slave tells in its object 0x1018:1; None without a mailbox."""
    try:
        answer = bus.read_sdo(slave, *VENDOR, kickcat.PARTIAL, 4, 2.0)
    except RuntimeError as error:
        if "inactive" in str(error):
            return None
        raise
    return int.from_bytes(answer[:4], "little")


def go(bus, cycles):
    """From INIT to OP and through the cycles; raises an error if anything fails."""
    bus.init(1.0)
    slaves = bus.slaves()
    vendors = [vendor(bus, slave) for slave in slaves]
    bus.create_mapping()
    bus.request_state(State.SAFE_OP)
    bus.wait_for_state(State.SAFE_OP, STATE_S)
    for slave in slaves:
        if slave.output_size > 0:
            slave.set_output_bytes(bytes(slave.output_size))
    bus.process_data_no_check()
    bus.request_state(State.OPERATIONAL)
    bus.wait_for_state(State.OPERATIONAL, STATE_S, bus.process_data_no_check)
    for _ in range(cycles):
        # Raises an error for every lost frame and every wrong working counter.
        bus.process_data()
    return {
        "vendors": vendors,
        "lengths": [[slave.input_size, slave.output_size] for slave in slaves],
        "states": [bus.get_state(slave).name for slave in slaves],
        "inputs": [slave.input_data.hex() for slave in slaves],
        "cycles": cycles,
    }


def main():
    interface, cycles = sys.argv[1], int(sys.argv[2]) if len(sys.argv) > 2 else 1_000
    link = kickcat.create_link(interface, "")
    link.set_timeout(FRAME_S)
    bus = kickcat.Bus(link)
    begun, goes = time.monotonic(), 0
    while True:
        goes += 1
        try:
            report = go(bus, cycles)
            break
        except Exception as error:
            print(f"go {goes}: {error}", file=sys.stderr)
            if time.monotonic() - begun > PATIENCE_S:
                raise
    print(json.dumps(report | {"goes": goes}), flush=True)


main()
