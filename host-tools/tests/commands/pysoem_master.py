"""Brings up a segment with pysoem (SOEM), an EtherCAT master of another project, and prints what it saw as JSON.

`python pysoem_master.py INTERFACE [CYCLES]`: from INIT to OP and back. Drives get SYNC0 pulses, are enabled and turn,
while every terminal with outputs gets a changing pattern. Ends with an error if a state or the enabled drives do not
come; the caller judges all else.
"""

import json
import struct
import sys
import time

import pysoem

# Longest wait for an answer or a state, s: a busy computer stops this program and the segment for long.
PATIENCE_S = 120
# Longest wait for one frame, us. SOEM triples it in places and keeps it in 32 bits.
FRAME_US = 30_000_000
# Process-data watchdog, ms: the default of 100 ms is too short on a busy computer.
WATCHDOG_MS = 6_000
SYNC0_NS = 1_000_000
DEVICE_NAME = 0x1008
MODES_OF_OPERATION = 0x6060
VENDOR_BECKHOFF, EL2004 = 0x2, 0x07D4_3052
# Registers of the slave controller.
WATCHDOG_STATUS, SYNC_MANAGER_ACTIVATE, OUTPUTS = 0x0440, 0x0806, 0x0F00
SYSTEM_TIME, SYNC_ACTIVATION, SYNC0_START, SYNC0_CYCLE = 0x0910, 0x0981, 0x0990, 0x09A0
# Velocity demand, digits; 140 are one revolution of the motor in a minute.
DEMAND = 14_000
# Control words that enable a drive, and the status word (under this mask) that each of them leads to.
STEPS = [(0x06, 0x21), (0x07, 0x23), (0x0F, 0x27)]
STATUS_MASK = 0x6F


class Drive:
    """Process data of a drive: mode, the order of its values, and which objects are assigned if not those that it has."""

    def __init__(self, mode, control_first, assigned=(), clock_bits=64):
        self.mode = mode
        self.control_first = control_first
        self.assigned = assigned
        self.clock_bits = clock_bits

    def outputs(self, control, velocity):
        return struct.pack("<Hi", control, velocity) if self.control_first else struct.pack("<iH", velocity, control)

    def inputs(self, data):
        """Status word and position."""
        if self.control_first:
            return struct.unpack("<Hi", data)
        position, status = struct.unpack("<iH", data)
        return status, position


# Drives by vendor and product. The AKD refuses SAFEOP with the process data that it has unasked.
DRIVES = {
    (VENDOR_BECKHOFF, 0x07D0_6014): Drive(-2, control_first=False),
    (0x6A, 0x0041_4B44): Drive(9, control_first=False, assigned=((0x1C12, 0x1702), (0x1C13, 0x1B01)), clock_bits=32),
    (0x0E7E, 0x0402): Drive(9, control_first=True),
}


def said(what):
    print(what, file=sys.stderr, flush=True)


class Bus:
    """The master with its slaves, and the working counters of all cycles."""

    def __init__(self, interface):
        limits = pysoem.settings.timeouts
        limits.ret = limits.safe = FRAME_US
        limits.eeprom = limits.tx_mailbox = limits.rx_mailbox = limits.state = PATIENCE_S * 1_000_000
        self.master = pysoem.Master()
        self.master.sdo_read_timeout = self.master.sdo_write_timeout = PATIENCE_S * 1_000_000
        self.master.open(interface)
        self.slaves = []
        self.drives = []
        self.digital = []

    def find(self):
        count = self.master.config_init()
        assert count > 0, "no slave answers"
        self.slaves = list(self.master.slaves)
        known = [(slave, DRIVES.get((slave.man, slave.id))) for slave in self.slaves]
        self.drives = [(slave, drive) for slave, drive in known if drive]
        self.digital = [slave for slave in self.slaves if (slave.man, slave.id) == (VENDOR_BECKHOFF, EL2004)]

    def states(self):
        """States without the error bit: SOEM acknowledges with every request, and a terminal mirrors that bit."""
        self.master.read_state()
        return [slave.state & 0x0F for slave in self.slaves]

    def reach(self, state, ask=True, cycle=lambda: None):
        """Waits until all slaves are in a state."""
        if ask:
            self.master.state = state
            self.master.write_state()
        begun = time.monotonic()
        while True:
            cycle()
            states = self.states()
            if states == [state] * len(states):
                return states
            codes = [f"{slave.al_status:#06x}" for slave in self.slaves]
            assert time.monotonic() - begun < PATIENCE_S, f"state {state}: {states}, AL status codes {codes}"

    def cycle(self):
        """One cycle; its working counter."""
        self.master.send_processdata()
        return self.master.receive_processdata(FRAME_US)

    def command(self, control, velocity):
        for slave, drive in self.drives:
            slave.output = drive.outputs(control, velocity)

    def shown(self):
        """Status word and position of every drive."""
        return [drive.inputs(slave.input) for slave, drive in self.drives]

    def enable(self):
        for control, status in STEPS:
            self.command(control, 0)
            begun = time.monotonic()
            while any(shown & STATUS_MASK != status for shown, _ in self.shown()):
                self.cycle()
                assert time.monotonic() - begun < PATIENCE_S, f"control word {control:#x}: {self.shown()}"

    def register(self, slave, address, form):
        return struct.unpack(form, answered(slave._fprd, address, struct.calcsize(form)))[0]

    def runs(self, slave):
        """Whether a slave's next SYNC0 pulse lies ahead; the register keeps a start time that was missed."""
        now = self.register(slave, SYSTEM_TIME, "<Q")
        bits = DRIVES[slave.man, slave.id].clock_bits
        ahead = (self.register(slave, SYNC0_START, "<Q") - now) % (1 << bits)
        return 0 < ahead < 1 << (bits - 1)

    def synchronise(self, slave):
        """Starts SYNC0. SOEM sets the start 100 ms ahead; a computer that was busy for longer has to try again."""
        begun = time.monotonic()
        while True:
            slave.dc_sync(True, SYNC0_NS)
            if self.runs(slave):
                return
            assert time.monotonic() - begun < PATIENCE_S, f"{slave.name}: SYNC0 does not start"


def answered(access, *arguments):
    """What an access to registers returns. pysoem waits milliseconds for an answer; a busy computer needs longer."""
    begun = time.monotonic()
    while True:
        try:
            return access(*arguments)
        except pysoem.WkcError:
            if time.monotonic() - begun > PATIENCE_S:
                raise


def device_name(slave):
    """Object 0x1008; `None` for a slave without a mailbox, which SOEM does not ask."""
    try:
        return slave.sdo_read(DEVICE_NAME, 0).decode()
    except pysoem.WkcError:
        return None


def objects(slave):
    """Index and name of every object in the SDO information."""
    return {f"{entry.index:#06x}": entry.name.decode() for entry in slave.od}


def main(interface, cycles="10000"):
    cycles = int(cycles)
    bus = Bus(interface)
    bus.find()
    said(f"{len(bus.slaves)} slaves")
    report = {"pysoem": pysoem.__version__, "states": {}, "cycles": cycles, "slaves": []}
    report["states"]["PREOP"] = bus.reach(pysoem.PREOP_STATE, ask=False)
    for slave in bus.slaves:
        identity = {"name": slave.name, "vendor": slave.man, "product": slave.id, "revision": slave.rev}
        report["slaves"].append({**identity, "device_name": device_name(slave)})
    for slave, drive in bus.drives:
        report["slaves"][bus.slaves.index(slave)]["objects"] = objects(slave)
        slave.sdo_write(MODES_OF_OPERATION, 0, struct.pack("b", drive.mode))
        for assignment, pdo in drive.assigned:
            slave.sdo_write(assignment, 0, b"\0")
            slave.sdo_write(assignment, 1, struct.pack("<H", pdo))
            slave.sdo_write(assignment, 0, b"\1")

    # Clocks come before the mapping, which asks for SAFEOP: drives look at SYNC0 then.
    report["clocks"] = bool(bus.master.config_dc())
    for slave, _ in bus.drives:
        bus.synchronise(slave)
    report["mapped_bytes"] = bus.master.config_map()
    said("mapped")
    for slave in bus.slaves:
        if slave.output:
            answered(slave.set_watchdog, "processdata", WATCHDOG_MS)
    # A slave adds 2 for its outputs and 1 for its inputs. SOEM's own figure leaves out a slave whose few output bits
    # end inside a byte.
    expected = sum(2 * bool(slave.output) + bool(slave.input) for slave in bus.slaves)
    report["working_counter"] = expected
    report["working_counter_of_soem"] = bus.master.expected_wkc
    # The mapping has asked for SAFEOP. A slave takes no second request before it has read the first.
    report["states"]["SAFEOP"] = bus.reach(pysoem.SAFEOP_STATE, ask=False)
    bus.cycle()
    report["states"]["OP"] = bus.reach(pysoem.OP_STATE, cycle=bus.cycle)
    bus.enable()
    said("enabled")

    before = bus.shown()
    bus.command(STEPS[-1][0], DEMAND)
    counters, disabled = {}, 0
    pattern = 0
    for number in range(cycles):
        pattern = number // 7 % 15 + 1
        for slave in bus.digital:
            slave.output = bytes([pattern])
        counter = bus.cycle()
        counters[counter] = counters.get(counter, 0) + 1
        disabled += any(status & STATUS_MASK != STEPS[-1][1] for status, _ in bus.shown())
    said("cycles done")
    report["working_counters"] = counters
    report["cycles_disabled"] = disabled

    def moved():
        return [after[1] - start[1] for start, after in zip(before, bus.shown())]

    # On a fast computer the cycles are over before a motor has taken over its load.
    more_counters, give_up_s = {expected: 0}, time.monotonic() + PATIENCE_S
    while any(distance <= 0 for distance in moved()) and time.monotonic() < give_up_s:
        counter = bus.cycle()
        more_counters[counter] = more_counters.get(counter, 0) + 1
        report["cycles_disabled"] += any(status & STATUS_MASK != STEPS[-1][1] for status, _ in bus.shown())
    report["more_working_counters"] = list(more_counters)
    report["states"]["OP after the cycles"] = bus.states()
    for (slave, _), distance in zip(bus.drives, moved()):
        sync0 = {
            "activation": bus.register(slave, SYNC_ACTIVATION, "<B"),
            "cycle_ns": bus.register(slave, SYNC0_CYCLE, "<I"),
            "runs": bus.runs(slave),
        }
        report["slaves"][bus.slaves.index(slave)].update({"moved": distance, "sync0": sync0})
    for slave, seen in zip(bus.slaves, report["slaves"]):
        seen["inputs"], seen["outputs"] = slave.input.hex(), slave.output.hex()
    for slave in bus.digital:
        # The sync manager lets a master only write; without it the memory behind can be read.
        fed = bus.register(slave, WATCHDOG_STATUS, "<H") & 1
        answered(slave._fpwr, SYNC_MANAGER_ACTIVATE, b"\0")
        held = bus.register(slave, OUTPUTS, "<B") & 0x0F
        report["slaves"][bus.slaves.index(slave)]["digital"] = {"set": pattern, "held": held, "fed": bool(fed)}

    report["states"]["INIT"] = bus.reach(pysoem.INIT_STATE)
    bus.master.close()
    print(json.dumps(report, indent=2))


main(*sys.argv[1:])
