#!/bin/sh
# What a newcomer sees: `make demo`. Runs from the project's folder with quatprop on the PATH.
set -eu
cd "$(dirname "$0")/.."
out=.demo
rm -rf "$out"
mkdir "$out"

run() {
    printf '\n$ %s\n' "$*"
    "$@"
}

# Log, its truth, and methods to try on it.
propagate() {
    log=$1 truth=$2
    shift 2
    name=$(basename "$log" | tr . _)
    results=
    for method in "$@"; do
        result="$out/$name.$method.csv"
        quatprop propagate "sample_logs/$log" -o "$result" --method "$method" --quiet
        results="$results $result"
    done
    # shellcheck disable=SC2086  # several names
    python sample_logs/truth.py "sample_logs/$truth" $results
}

echo 'What is in the logs:'
run quatprop info sample_logs/spin.csv sample_logs/coning.mcap sample_logs/tumbling.bag \
    sample_logs/tumbling_ros2 sample_logs/rest.parquet

printf '\nFrom a log to its attitude series:\n'
run quatprop propagate sample_logs/tumbling.bag -o "$out/tumbling.csv" --method coning
run head -n 3 "$out/tumbling.csv"

printf '\nHow far from the truth, by the method that says which samples rule an interval:\n\n'
propagate spin.csv spin.truth.csv start
propagate coning.mcap coning.truth.csv start mean coning
propagate tumbling.bag tumbling.truth.csv start mean coning
propagate tumbling_ros2 tumbling.truth.csv coning
propagate rest.parquet rest.truth.parquet start
printf '\nA constant rate is exact whatever the method; moving axes want the coning term; a gyroscope at\n'
printf 'rest with a bias drifts with it. The results are in %s.\n' "$out"
