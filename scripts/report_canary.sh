#!/usr/bin/env bash
# Opens an issue that the newest release of a package does not pass, unless one is open. Needs gh and its token.
#
#   RUN=https://... scripts/report_canary.sh lerobot
set -euo pipefail

package=${1:?which package}
title="The newest $package does not pass"
gh label create canary --color fbca04 --description "Newer releases of what we need" --force
if [[ $(gh issue list --label canary --state open --json title --jq '.[].title') == *"$title"* ]]; then
  echo "canary: an issue on $package is open already"
  exit
fi
gh issue create --title "$title" --label canary \
  --body "\`scripts/canary.sh $package\` failed: ${RUN:?address of the run}. It shows the versions, and which tests failed."
