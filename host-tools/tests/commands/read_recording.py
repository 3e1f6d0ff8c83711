"""Reads a recording with the `mcap` package alone and compares it with telemetry.csv, value by value.

Messages are taken apart by the definitions that are in the file, not by what this project knows of them.
"""

import csv
import struct
import sys

from mcap.reader import NonSeekingReader, make_reader

KINDS = {"uint8": ("B", 1), "uint16": ("H", 2), "uint32": ("I", 4), "float32": ("f", 4), "float64": ("d", 8)}


def fields_of(definition):
    """Name, format and place of every field, and the names of the modes."""
    place, fields, modes = 4, [], {}
    for line in definition.splitlines():
        line = line.split("#")[0].strip()
        if not line:
            continue
        kind, name = line.split()
        if "=" in name:
            name, value = name.split("=")
            modes[int(value)] = name.replace("_", "").lower()
            continue
        # A sequence: its length, then its elements. It is the last field.
        letter, size = KINDS["uint32" if kind.endswith("[]") else kind]
        place = 4 + (place - 4 + size - 1) // size * size
        fields.append((name, "<" + letter, place))
        place += size
    return fields, modes


def text_of(name, value, modes):
    if name == "mode":
        return modes[value]
    if name in ("t_ms", "stroke", "pen"):
        return str(value)
    decimals = 4 if name.endswith("_mm") else 5 if name.startswith("v") else 7
    return f"{value:.{decimals}f}"


def main(recording, table):
    with open(table, newline="") as lines:
        rows = list(csv.DictReader(lines))
    with open(recording, "rb") as stream:
        reader = make_reader(stream, validate_crcs=True)
        summary = reader.get_summary()
        names = [channel.topic for channel in summary.channels.values()]
        assert sorted(names) == ["/event", "/gap", "/sample", "/status"], names
        attached = [attachment.name for attachment in reader.iter_attachments()]
        assert attached == ["etherpen.toml"], attached
        facts = {key: value for record in reader.iter_metadata() for key, value in record.metadata.items()}
        assert facts["source"], facts
        count, values = 0, 0
        fields, modes = None, None
        for schema, channel, message in reader.iter_messages(topics=["/sample"]):
            if fields is None:
                assert (schema.encoding, channel.message_encoding) == ("ros2msg", "cdr")
                fields, modes = fields_of(schema.data.decode())
                points = [name for name in rows[0] if name.startswith("io_")]
                numbers = {name for name, _, _ in fields} - {"io_set", "io_missing", "io_words"}
                assert numbers and numbers == set(rows[0]) - set(points)
            row = rows[count]
            bits = {}
            for name, form, place in fields:
                (value,) = struct.unpack_from(form, message.data, place)
                if name not in numbers:
                    bits[name] = value
                    continue
                expected = row[name].lower() if name == "mode" else row[name]
                found = text_of(name, value, modes)
                assert found == expected, f"row {count}, {name}: {found} in the recording, {expected} in the table"
                values += 1
            for place, name in enumerate(points):
                found = "" if bits["io_missing"] >> place & 1 else str(bits["io_set"] >> place & 1)
                assert found == row[name], f"row {count}, {name}: {found} in the recording, {row[name]} in the table"
                values += 1
            assert message.log_time == int(row["t_ms"]) * 1_000_000
            assert message.sequence == count
            count += 1
        assert count == len(rows), f"{count} samples, {len(rows)} rows"
        total = sum(summary.statistics.channel_message_counts.values())
        assert total == summary.statistics.message_count
        # A second in the middle, by the chunk index.
        middle = int(rows[len(rows) // 2]["t_ms"]) * 1_000_000
        part = list(reader.iter_messages(topics=["/sample"], starting_at=middle, ending_before=middle + 100_000_000))
        assert len(part) == 100, len(part)
    with open(recording, "rb") as stream:
        front = sum(1 for _ in NonSeekingReader(stream, validate_crcs=True).iter_messages())
        assert front == total, (front, total)
    print(f"{count} samples, {values} values compared")


main(*sys.argv[1:])
