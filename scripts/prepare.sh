# shellcheck shell=bash
# Set-up shared by run_demo and run_tests, which source this file: system packages, a venv, the build. Images run it
# (Dockerfile).
# Everything it creates is in .workspace/ and build/, both ignored by git. Every step is skipped if
# nothing has changed.
#
# The functions, in the order of their use:
#   prepare        do all of the set-up below
#   use_workspace  put the venv and the built workspace into this shell's environment
#   end_session    end every process of this run that is still running

set -u

# A shell that was started with SIGINT ignored (in the background of a script, under nohup, by some CI)
# cannot trap it, and neither can its children. In this case, start again with the default handler.
if (( 0x$(sed -n 's/^SigIgn:[[:space:]]*//p' "/proc/$$/status") & 2 )); then
    exec perl -e '$SIG{INT} = "DEFAULT"; exec @ARGV' "$0" "$@"
fi

ROOT=$(cd "$(dirname "${BASH_SOURCE[0]}")/.." && pwd -P)
WORKSPACE=$ROOT/.workspace
VENV=$WORKSPACE/venv
# If this checkout is in the user's own catkin workspace, ROS must not find what this workspace holds: rosrun looks for
# executables everywhere but under build/, roslaunch for launch files everywhere but in hidden folders.
CATKIN_WS=$ROOT/build/.catkin_ws
PACKAGE=gspn_framework_package

# Every process that this run starts has this mark in its environment, even if it changes its process
# group or session; end_session finds the processes by it.
SESSION="$(basename "$0").$$.$(date +%s)"
export GSPN_SESSION="${GSPN_SESSION:-}/$SESSION"

export LC_ALL=C.UTF-8
# Hundreds of processes import the package. Without bytecode, each would compile it again, which takes longer than
# most of them run.
unset PYTHONDONTWRITEBYTECODE

say() { printf '%s: %s\n' "$(basename "$0")" "$*"; }
die() { printf '%s: error: %s\n' "$(basename "$0")" "$*" >&2; exit 2; }

prepare() {
    mkdir -p "$WORKSPACE"
    exec 9>"$WORKSPACE/lock"
    flock 9  # if two commands start at once, they prepare one after the other
    prepare_system
    make_venv
    prepare_venv &
    prepare_build
    wait $! || exit
    exec 9>&-
}

# --- the system's packages

is_noetic() { [ -f /opt/ros/noetic/setup.bash ]; }

system_packages() {
    local column=1
    is_noetic && column=2
    awk -v column=$column '
        /^[[:space:]]*(#|$)/ { next }
        { name = (column <= NF) ? $column : $1; if (name != "-") print name }
    ' "$ROOT/scripts/apt-packages.txt"
}

missing_packages() {
    system_packages | while read -r name; do
        [ "$(dpkg-query -W -f '${db:Status-Status}' "$name" 2>/dev/null)" = installed ] || printf '%s ' "$name"
    done
}

as_root() {
    if [ "$(id -u)" -eq 0 ]; then
        env DEBIAN_FRONTEND=noninteractive "$@"
    elif command -v sudo >/dev/null; then
        sudo env DEBIAN_FRONTEND=noninteractive "$@"
    else
        die "needs root, or sudo, for: $*"
    fi
}

prepare_system() {
    command -v apt-get >/dev/null || die "needs Debian 12, or Ubuntu 20.04 with ROS Noetic (no apt-get here)"
    local missing
    missing=$(missing_packages)
    [ -n "$missing" ] || return 0
    say "installing system packages: $missing"
    local log=$WORKSPACE/apt.log apt=(apt-get -q -o DPkg::Lock::Timeout=600 -o Acquire::Retries=3)
    # shellcheck disable=SC2086  # a list of words
    { as_root "${apt[@]}" update && as_root timeout 1800 "${apt[@]}" install -y --no-install-recommends $missing; } \
        </dev/null >"$log" 2>&1 || { tail -n 20 "$log" >&2; die "apt-get failed; all of its output: $log"; }
}

# --- the venv: packages that the system lacks

# The system's versions of the libraries that the package needs, as constraints for pip: another NumPy in the venv
# would replace the one that SciPy and ROS are built for.
system_versions() {
    /usr/bin/python3 - <<'PYTHON'
import importlib.metadata
for name in ("click", "Flask", "itsdangerous", "Jinja2", "jsonschema", "lxml", "MarkupSafe", "matplotlib",
             "numpy", "Pillow", "psutil", "PyYAML", "scipy", "waitress", "Werkzeug"):
    try:
        print(name + "==" + importlib.metadata.version(name))
    except importlib.metadata.PackageNotFoundError:
        pass
PYTHON
}

make_venv() {
    [ -x "$VENV/bin/python" ] || /usr/bin/python3 -m venv --system-site-packages "$VENV" || die "cannot make $VENV"
}

prepare_venv() {
    local list=$ROOT/scripts/requirements.txt constraints=$WORKSPACE/constraints.txt key
    system_versions >"$constraints" || die "cannot find the versions of the system's libraries"
    key=$({ echo "$VENV"; /usr/bin/python3 --version; cat "$list" "$constraints"; } | sha256sum)
    [ "$(cat "$VENV/prepared" 2>/dev/null)" = "$key" ] && return 0
    say "installing Python packages into .workspace/venv"
    # Python compiles what is imported when it is, which is a small part of it
    local log=$WORKSPACE/pip.log pip=("$VENV/bin/python" -m pip install --no-compile --disable-pip-version-check)
    # the pip of Ubuntu 20.04 does not search for compatible versions
    { timeout 300 "${pip[@]}" "pip>=21.3" && timeout 1200 "${pip[@]}" -c "$constraints" -r "$list"; } \
        </dev/null >"$log" 2>&1 || { tail -n 20 "$log" >&2; die "pip failed; all of its output: $log"; }
    echo "$key" >"$VENV/prepared"
}

# --- the catkin workspace

# The package in the workspace: a folder with links to everything at the top of the checkout. A single
# link to the checkout would be a loop, since the checkout contains the workspace.
link_package() {
    local link=$CATKIN_WS/src/$PACKAGE entry
    mkdir -p "$link"
    find "$link" -xtype l -delete
    for entry in "$ROOT"/*; do
        [ "$entry" = "$ROOT/build" ] || [ -L "$link/${entry##*/}" ] || ln -s "$entry" "$link/"
    done
}

# The inputs of the build. Python code and launch files run in place and need no build.
build_key() {
    {
        ls "$ROOT"
        echo "$ROOT"
        cd "$ROOT" || exit
        cat CMakeLists.txt package.xml setup.py action/* msg/* srv/*
        find scripts launch test/rostest -type f 2>/dev/null | LC_ALL=C sort
        find scripts -maxdepth 1 -type f | LC_ALL=C sort | xargs cat
    } | sha256sum
}

prepare_build() {
    local key log=$WORKSPACE/build.log
    rm -rf "$ROOT"/build/{catkin_ws,check_install}  # where earlier versions built, and ROS found it
    link_package
    key=$(build_key)
    [ "$(cat "$CATKIN_WS/built" 2>/dev/null)" = "$key" ] && return 0
    say "building the workspace"
    (
        # build on top of the installed ROS only, whatever else this shell has sourced
        unset CMAKE_PREFIX_PATH PYTHONPATH ROS_PACKAGE_PATH
        use_ros
        # the package has Python only: no headers for programs in other languages
        PATH=$VENV/bin:$PATH ROS_LANG_DISABLE=gencpp:geneus:genlisp:gennodejs timeout 900 \
            catkin_make -C "$CATKIN_WS" -DPYTHON_EXECUTABLE="$VENV/bin/python" </dev/null >"$log" 2>&1
    ) || { tail -n 30 "$log" >&2; die "catkin_make failed; all of its output: $log"; }
    echo "$key" >"$CATKIN_WS/built"
}

use_ros() {
    # ROS's set-up files read variables that may be unset
    set +u
    # shellcheck disable=SC1091
    if is_noetic; then . /opt/ros/noetic/setup.bash; fi
    set -u
}

use_workspace() {
    set +u
    # shellcheck disable=SC1091
    . "$CATKIN_WS/devel/setup.bash"
    set -u
    export PATH=$VENV/bin:$PATH
    # roslaunch looks for one function of distutils, which a venv would take from setuptools: a third of its start
    export SETUPTOOLS_USE_DISTUTILS=stdlib
}

# --- the end

# The ids of all processes with this run's mark, except this shell.
session_processes() {
    local marked id
    mapfile -t marked < <(grep -lszE "^GSPN_SESSION=.*/$SESSION(/|$)" /proc/[0-9]*/environ)
    wait $!  # grep has found itself too: wait until it has ended
    for id in "${marked[@]}"; do
        id=${id//[!0-9]/}
        ! [ -e "/proc/$id" ] || printf '%s ' "$id"
    done
}

# The same, with a second search if the first one finds none: a process that is just starting a program has no mark.
remaining_processes() {
    local ids
    ids=$(session_processes)
    [ -n "$ids" ] || { sleep 0.2; ids=$(session_processes); }
    printf '%s' "$ids"
}

GRACE=5  # seconds that processes have to end after each signal

end_session() {
    local signal deadline ids
    for signal in INT TERM KILL; do
        deadline=$((SECONDS + GRACE))
        ids=$(remaining_processes)
        # shellcheck disable=SC2086  # a list of words
        [ -z "$ids" ] || kill -s $signal $ids 2>/dev/null
        while [ -n "$ids" ] && [ $SECONDS -lt $deadline ]; do
            sleep 0.1
            ids=$(remaining_processes)
        done
        [ -n "$ids" ] || return 0
    done
}

# --- by itself: bash scripts/prepare.sh

[ "${BASH_SOURCE[0]}" != "$0" ] || prepare
