#!/usr/bin/env bash
# Used by run_tests: installs the package, by catkin and by pip, and uses only the installed files.

# shellcheck source=scripts/prepare.sh
. "$(dirname "${BASH_SOURCE[0]}")/prepare.sh"

INSTALLED=$CATKIN_WS/install
ASIDE=$ROOT/build/.check_install  # see CATKIN_WS in prepare.sh
SITE=$INSTALLED/lib/python3/dist-packages
SHARE=$INSTALLED/share/$PACKAGE

# A shell that only knows the install space, and neither the checkout nor the devel space.
installed() {
    (cd / && env -i HOME="$HOME" PATH=/usr/sbin:/usr/bin:/sbin:/bin ROS_HOME="$WORKSPACE/ros_home" LC_ALL=C.UTF-8 \
        GSPN_SESSION="$GSPN_SESSION" bash -c ". '$INSTALLED/setup.bash'; set -e; $1")
}

# same_files WHAT FROM TO FIND_OPTION...: checks that every file below FROM that the options select is identical in TO.
same_files() {
    local what=$1 from=$2 to=$3 sums=$WORKSPACE/install.sums
    shift 3
    (cd "$from" && find . -type f -not -path '*/__pycache__/*' "$@" -exec sha256sum {} +) >"$sums"
    (cd "$to" && sha256sum --quiet --check) <"$sums" || die "not installed, or another: files of $what"
    echo "$what: $(wc -l <"$sums") files"
}

# only_product WHAT: checks that the file names on standard input are of no test and no experiment.
only_product() {
    local names
    names=$(grep -E '(^|/)(benchmarks|tests?)/|(^|-packages/)agreement/|(^|/)(test_[^/]*\.py|conftest\.py|[^/]*\.test)$' || true)
    [ -z "$names" ] || die "$1: installed, but no part of the product: $names"
}

rm -rf "$INSTALLED"
log=$WORKSPACE/install.log
make -C "$CATKIN_WS/build" --no-print-directory install >"$log" 2>&1 || { tail -n 20 "$log"; die "installation failed"; }

for part in $PACKAGE gspn; do
    same_files "$part" "$ROOT/$part" "$SITE/$part"
done
for folder in launch plans; do
    same_files "$folder" "$ROOT/$folder" "$SHARE/$folder"
done
only_product "the install space" < <(find "$INSTALLED" -type f -printf '%P\n')

installed "
    rosrun $PACKAGE gspn --version
    [ \"\$(rospack find $PACKAGE)\" = '$SHARE' ]
    rosmsg show $PACKAGE/FiredTransition >/dev/null
    rossrv show $PACKAGE/GetState >/dev/null
    '$VENV/bin/python' -c '
import $PACKAGE.cli.main as main, $PACKAGE.msg, $PACKAGE.srv
assert main.__file__.startswith(\"$SITE\"), main.__file__
import gspn
assert gspn.example(\"patrol\").check().accepted
'" || die "the install space does not run"

# In one process: each start takes longer than the check.
installed "python3 -c '
import sys
from $PACKAGE.cli.main import main
for plan in sys.argv[1:]:
    expected = int(\"/fork_join/\" in plan)  # it is for runs without ROS only, and the check says so
    assert main([\"check\", plan]) == expected, plan
' '$SHARE'/plans/*/plan.json >/dev/null" || die "gspn check: another exit code than it should have"

# The Debian package holds the same files (where it can be built: Debian 12).
if . /etc/os-release && [ "${VERSION_CODENAME:-}" = bookworm ]; then
    rm -rf "$ASIDE/deb"
    # compressing it would take a tenth of this script's processor time
    deb=$(DPKG_DEB_COMPRESSOR_TYPE=none "$ROOT/scripts/make_deb" "$ASIDE/deb") || die "scripts/make_deb fails"
    dpkg-deb -x "$deb" "$ASIDE/deb/root"
    for part in $PACKAGE gspn; do
        same_files "deb: $part" "$ROOT/$part" "$ASIDE/deb/root/usr/lib/python3/dist-packages/$part"
    done
    for folder in launch plans; do
        same_files "deb: $folder" "$ROOT/$folder" "$ASIDE/deb/root/usr/share/$PACKAGE/$folder"
    done
    bash -n "$ASIDE/deb/root/usr/share/bash-completion/completions/gspn" || die "the completion for bash is no script"
    zcat "$ASIDE/deb/root/usr/share/man/man1/gspn.1.gz" | grep "^.SS simulate" >/dev/null || die "the manual page is not whole"
    only_product "the Debian package" < <(find "$ASIDE/deb/root" -type f -printf '%P\n')
    cmp <(dpkg-deb -f "$deb" Version) <(echo "$(cd "$ROOT" && /usr/bin/python3 setup.py --version)-1") || die "another version"
fi

# The room from the installed files only: what it offers a robot, and a team in it that is seen to drive. The rest of that
# test would find here what it finds in the checkout. rostest looks for a test's program in the package, and tests are not
# installed.
sed 's/def test_[2-57]_/def left_out_/' "$ROOT/test/rostest/world/test_world_node.py" >"$INSTALLED/lib/$PACKAGE/test_world_node.py"
chmod 755 "$INSTALLED/lib/$PACKAGE/test_world_node.py"
installed "export ROS_HOSTNAME=localhost GSPN_PATIENCE=${GSPN_PATIENCE:-1}; rostest '$ROOT/test/rostest/world/world.test'" \
    || die "the room does not run"

# Without ROS, by pip: a wheel built from the files of a checkout, in an empty environment. There the first three commands
# of each page for beginners are typed, as they stand.
CHECKOUT=$ASIDE/pip_checkout EMPTY=$ASIDE/pip_venv BEGINNER=$ASIDE/beginner
rm -rf "$CHECKOUT" "$EMPTY" "$BEGINNER"
mkdir -p "$CHECKOUT" "$BEGINNER"
cp -r "$ROOT/$PACKAGE" "$ROOT"/{docs,gspn,msg,plans,setup.py,package.xml,pyproject.toml,LICENSE,README.md} "$CHECKOUT"
log=$WORKSPACE/pip_install.log
pip=("$VENV/bin/python" -m pip --disable-pip-version-check)
{ /usr/bin/python3 -m venv --without-pip "$EMPTY" \
    && "${pip[@]}" wheel -q --no-deps -w "$CHECKOUT/dist" "$CHECKOUT" \
    && "${pip[@]}" --python "$EMPTY" install -q --no-compile --prefer-binary "$CHECKOUT"/dist/*.whl; } \
    >"$log" 2>&1 || { tail -n 20 "$log"; die "pip does not install the package"; }
only_product "the wheel" < <("$EMPTY/bin/python" -m zipfile -l "$CHECKOUT"/dist/*.whl | awk '{ print $1 }')
SITE=$(echo "$EMPTY"/lib/python3*/site-packages)
for part in $PACKAGE gspn; do
    same_files "$part, by pip" "$ROOT/$part" "$SITE/$part"
done
same_files "plans, by pip" "$ROOT/plans" "$SITE/$PACKAGE/plans" -not -path './runs/*'
for page in README.md docs/{five_minutes,first_plan,migration}.md; do
    folder=$BEGINNER/$(basename "$page" .md)
    mkdir -p "$folder"
    "$VENV/bin/python" "$ROOT/test/unit/document_commands.py" "$ROOT/$page" 3 "$folder" >"$folder/commands"
    if [ "$page" = docs/migration.md ]; then  # with the files that the reader has
        cp "$ROOT"/test/rostest/thesis/{input.json,net.xml} "$folder"
        printf '%s\n' "gspn check input.json" "mkdir patrol" "gspn convert input.json patrol" >"$folder/commands"
    fi
    [ -s "$folder/commands" ] || die "$page begins with no command"
    (cd "$folder" && env -i PATH="$EMPTY/bin:/usr/bin:/bin" HOME="$folder" LC_ALL=C.UTF-8 bash -ex commands >log 2>&1) \
        || { cat "$folder/log"; die "the first commands of $page fail where only pip has installed the package"; }
done
(cd / && env -i PATH=/usr/bin:/bin LC_ALL=C.UTF-8 bash -ec "
    [ \"\$('$EMPTY/bin/gspn' --version)\" = 'gspn $(PYTHONPATH=$ROOT python3 -c "import $PACKAGE as p; print(p.__version__)")' ]
    '$EMPTY/bin/python' -c 'import $PACKAGE.visualizer.serving'
    '$EMPTY/bin/python' -c 'import gspn; assert gspn.example(\"patrol\").check().accepted'
    '$EMPTY/bin/python' -m gspn.examples
") || die "the package that pip has installed does not run"
