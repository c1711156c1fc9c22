#!/bin/sh
# Run the tests side by side on all processors; with --all also slow ones, and at last those one by
# one that nothing may disturb.
#
# Usage: scripts/test.sh [--all] [ARGUMENT...], which pytest gets in both parts.
set -eu
CDPATH='' cd -- "$(dirname -- "$0")/.."

chosen='not slow'
if [ "${1:-}" = --all ]; then
    chosen='slow or not slow'
    shift
fi
none=5 # what pytest exits with where no test matches
worst=$none

run() {
    status=0
    .venv/bin/pytest "$@" || status=$?
    if [ "$status" != "$none" ] && { [ "$worst" = "$none" ] || [ "$worst" = 0 ]; }; then
        worst=$status
    fi
}

# Two more than there are processors, as tests of the graph wait for one another now and then, and as
# other programs may take their share. They come first, so that what is left at the end is short.
run --numprocesses "$(($(nproc) + 2))" --dist loadfile --no-loadscope-reorder \
    -m "($chosen) and not alone" "$@"
# None of the quick ones is alone.
[ "$chosen" = 'not slow' ] || run -m alone "$@"
exit "$worst"
