#!/usr/bin/env bash
# Used by run_tests: installs the package, and uses it from the install space alone.

# shellcheck source=scripts/prepare.sh
. "$(dirname "${BASH_SOURCE[0]}")/prepare.sh"

INSTALLED=$CATKIN_WS/install
SITE=$INSTALLED/lib/python3/dist-packages
SHARE=$INSTALLED/share/$PACKAGE

# A shell that knows the install space only: neither the checkout nor the devel space.
installed() {
    (cd / && env -i HOME="$HOME" PATH=/usr/sbin:/usr/bin:/sbin:/bin ROS_HOME="$WORKSPACE/ros_home" LC_ALL=C.UTF-8 \
        GSPN_SESSION="$GSPN_SESSION" bash -c ". '$INSTALLED/setup.bash'; set -e; $1")
}

# same_files WHAT FROM TO FIND_OPTION...: every file below FROM that the options choose is below TO, and the same.
same_files() {
    local what=$1 from=$2 to=$3 name count=0
    shift 3
    while read -r name; do
        cmp "$from/$name" "$to/$name" || die "not installed, or another: $what/$name"
        count=$((count + 1))
    done < <(cd "$from" && find . -type f -not -path '*/__pycache__/*' "$@")
    echo "$what: $count files"
}

rm -rf "$INSTALLED"
log=$WORKSPACE/install.log
make -C "$CATKIN_WS/build" --no-print-directory install >"$log" 2>&1 || { tail -n 20 "$log"; die "installation failed"; }

same_files "$PACKAGE" "$ROOT/$PACKAGE" "$SITE/$PACKAGE"
for folder in launch plans; do
    same_files "$folder" "$ROOT/$folder" "$SHARE/$folder"
done

installed "
    rosrun $PACKAGE gspn --version
    [ \"\$(rospack find $PACKAGE)\" = '$SHARE' ]
    rosmsg show $PACKAGE/FiredTransition >/dev/null
    rossrv show $PACKAGE/GetState >/dev/null
    '$VENV/bin/python' -c '
import $PACKAGE.cli.main as main, $PACKAGE.msg, $PACKAGE.srv
assert main.__file__.startswith(\"$SITE\"), main.__file__
'" || die "the install space does not run"

count=0
for plan in "$SHARE"/plans/*/plan.json; do
    here=$ROOT/${plan#"$SHARE/"}
    (cd "$ROOT" && "$VENV/bin/python" -m "$PACKAGE" check "$here" >/dev/null 2>&1)
    expected=$?
    installed "rosrun $PACKAGE gspn check '$plan' >/dev/null 2>&1"
    status=$?
    [ $status -eq $expected ] || die "gspn check: exit code $status, not $expected: $plan"
    count=$((count + 1))
done
echo "gspn check of $count plans: as in the checkout"

# The room from the installed files alone. rostest looks for the program of a test in the package, where tests are not
# installed.
install -m 755 "$ROOT/test/rostest/world/test_world_node.py" "$INSTALLED/lib/$PACKAGE/"
installed "ROS_HOSTNAME=localhost rostest '$ROOT/test/rostest/world/world.test'" || die "the room does not run"
