#!/usr/bin/env bash
# Installs everything into .venv: the system library that Open3D needs, the locked packages, this project. Then compiles its
# kernels for this processor.
# It does nothing where .venv already holds what the locks and pyproject.toml ask for.
set -euo pipefail
cd "$(dirname "$0")/.."

say() { printf '%s\n' "$*" >&2; }

stamp=.venv/.mlsroad-installed
want=$(cat requirements.lock requirements-torch.lock pyproject.toml | sha256sum | cut -d' ' -f1)
if [ -f "$stamp" ] && [ "$(cat "$stamp")" = "$want" ]; then
    exit 0
fi

version() { "$1" -c 'import sys; print("%d.%d" % sys.version_info[:2])' 2>/dev/null || true; }
candidates=(python3.13 python3.12 python3.11 python3) # requirements.lock has wheels for these
[ -z "${PYTHON:-}" ] || candidates=("$PYTHON")
python=
for candidate in "${candidates[@]}"; do
    case "$(version "$candidate")" in 3.11 | 3.12 | 3.13) python=$candidate && break ;; esac
done
if [ -z "$python" ]; then
    say "mlsroad needs Python 3.11, 3.12 or 3.13 and found none. Debian 12 and 13 have one as python3 (apt-get install python3);"
    say "elsewhere: pyenv install 3.13, conda create -n mlsroad python=3.13, or set PYTHON to its path."
    exit 1
fi

as_root=()
if [ "$(id -u)" -ne 0 ]; then
    if command -v sudo >/dev/null 2>&1 && sudo -n true 2>/dev/null; then as_root=(sudo -n); else as_root=(false); fi
fi
apt_install() {
    command -v apt-get >/dev/null 2>&1 || return 1
    "${as_root[@]}" apt-get update -qq && "${as_root[@]}" apt-get install -y -qq --no-install-recommends "$@"
}

has_libusb() { "$python" -c 'import ctypes; ctypes.CDLL("libusb-1.0.so.0")' 2>/dev/null; }
if ! has_libusb; then
    say "Open3D needs the system library libusb-1.0; installing it ..."
    if ! apt_install libusb-1.0-0 >&2 || ! has_libusb; then
        say "libusb-1.0 is missing and could not be installed. As root: apt-get install libusb-1.0-0 (Debian, Ubuntu),"
        say "dnf install libusb1 (Fedora), pacman -S libusb (Arch). Without root, unpack it in your home folder:"
        say "  apt-get download libusb-1.0-0 && dpkg -x libusb-1.0-0_*.deb ~/libusb"
        say "  export LD_LIBRARY_PATH=\$(dirname \$(find ~/libusb -name 'libusb-1.0.so.0')):\$LD_LIBRARY_PATH"
        say "or take it from conda-forge: conda install libusb. Then run the same command again."
        exit 1
    fi
fi

if [ ! -x .venv/bin/python ] && ! "$python" -m venv .venv 2>/tmp/mlsroad-venv.$$; then
    rm -rf .venv
    say "Python's venv module is incomplete here; installing it ..."
    if ! apt_install "python$(version "$python")-venv" >&2 || ! "$python" -m venv .venv; then
        cat /tmp/mlsroad-venv.$$ >&2
        say "A virtual environment could not be made. As root: apt-get install python$(version "$python")-venv;"
        say "without root: $python -m pip install --user virtualenv && $python -m virtualenv .venv"
        exit 1
    fi
fi
rm -f /tmp/mlsroad-venv.$$

say "Installing the locked packages into .venv ..."
.venv/bin/python scripts/install_locked.py
.venv/bin/python -c 'import open3d' || { say "Open3D does not import; the message above says why."; exit 1; }

# Numba keeps what it compiles beside the sources. Commands on tiny streets, in folders that are thrown away, use nearly every kernel;
# others are compiled when they are first used. Two processes share the work: one labels a street and then runs all methods, the other
# starts with the methods that come last.
say "Compiling kernels for this processor (a few minutes, once) ..."
scratch=$(mktemp -d)
trap 'rm -rf "$scratch"' EXIT
bin=$PWD/.venv/bin
log=$PWD/.venv/compiling.log
: > "$log"
unset MLFLOW_TRACKING_URI
for folder in all last; do
    mkdir -p "$scratch/$folder/src"
    cp -r conf pyproject.toml "$scratch/$folder"
    cp conf/tiny.yml "$scratch/$folder/conf/local/parameters.yml"
done
methods() { # a folder, and options of `kedro run`
    (cd "$scratch/$1" && "$bin/kedro" run --pipelines=all_methods --params=execution.backend=sequential "${@:2}") >> "$log" 2>&1
}
label() {
    (cd "$scratch" && "$bin/mlsroad" label street -o labelled && "$bin/mlsroad" inspect street -o inspected) >> "$log" 2>&1
}
last=simulate,ingest,ground_removal,segmentation,visual_words,hough_forest,object_matching,bottom_up_top_down,recognition,image_labels
compiled=yes
(cd "$scratch" && "$bin/mlsroad" simulate --preset tiny -o street) >> "$log" 2>&1 || compiled=no
methods last --tags=$last &
other=$!
label || compiled=no
methods all || compiled=no
wait $other || compiled=no
if [ $compiled = no ]; then
    grep -v '^ ' "$log" | tail -n 20 >&2
    say "The kernels could not all be compiled; .venv/compiling.log says why. They are compiled when they are first used."
fi

printf '%s' "$want" > "$stamp"
say "Installed."
