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

# Log, its truth, and the methods to try on it: one line each of how far from the truth.
errors() {
    log=$1 truth=$2
    shift 2
    for method in "$@"; do
        result="$out/$(basename "$log" | tr . _).$method.parquet"
        quatprop propagate "sample_logs/$log" -o "$result" --method "$method" --quiet
        quatprop compare "sample_logs/$truth" "$result" |
            awk -v log_name="$log" -v method="$method" \
                '/^  max/ {printf "%-14s %-7s %12s rad %12s deg\n", log_name, method, $2, $4}'
    done
}

echo 'What is in the logs:'
run quatprop info sample_logs/spin.csv sample_logs/coning.mcap sample_logs/tumbling.bag \
    sample_logs/tumbling_ros2 sample_logs/rest.parquet

printf '\nFrom a log to its attitude series:\n'
run quatprop propagate sample_logs/tumbling.bag -o "$out/tumbling.csv" --method coning --plot "$out/tumbling.png"
run head -n 3 "$out/tumbling.csv"

printf '\nHow far that is from the truth, which is known in closed form:\n'
run quatprop compare sample_logs/tumbling.truth.csv "$out/tumbling.csv" --tol 0.1deg

printf '\nThe largest error of every log, by integration rule:\n\n'
errors spin.csv spin.truth.csv start
errors coning.mcap coning.truth.csv start coning cubic
errors tumbling.bag tumbling.truth.csv start coning cubic
errors tumbling_ros2 tumbling.truth.csv coning
errors rest.parquet rest.truth.parquet start
printf '\nA constant rate is exact with every method; moving axes need coning or cubic; a gyroscope at rest\n'
printf 'with a bias drifts with it. The results and a picture are in %s.\n' "$out"
