// What to show: the start and the policies that tell most, and the address that says what is shown.

const kept = (test) => DATA.recordings.filter(test);
const unique = (values) => [...new Set(values)];
const isReference = ({ scenario, policy }) =>
  DATA.rankings.some((one) => one.scenario === scenario && one.references.includes(policy));

/** 1 where all went well on a start, else 0; contacts count only where they can. */
function quality({ outcome: { collision_free: free, success } }) {
  return Number(free === "" ? success : free);
}

/** The same over all starts of a policy, from 0 to 1. */
function shareOf({ scenario, policy }) {
  const row = DATA.results.find((one) => one.scenario === scenario && one.policy === policy);
  return Number(row.collision_free_success === "" ? row.success : row.collision_free_success);
}

/**
 * The two recordings of one start that differ most tellingly: the better one of a policy that leads,
 * the worse one of a strong rival; where all go equally well, those whose times differ most.
 */
function contrast(recordings) {
  const competing = recordings.filter((one) => !isReference(one));
  const pool = competing.length > 1 ? competing : recordings;
  const leads = ({ policy }) => (DATA.leaders.indexOf(policy) + DATA.leaders.length + 1) %
    (DATA.leaders.length + 1); // 0 for the leader, most for one that never leads
  const starts = new Map();
  for (const one of pool) {
    const name = `${one.start} ${one.scenario}`;
    starts.set(name, [...(starts.get(name) ?? []), one]);
  }
  let [best, most] = [null, null];
  for (const group of starts.values())
    for (const better of group)
      for (const worse of group) {
        if (better === worse) continue;
        const gap = quality(better) - quality(worse);
        const later = worse.outcome.time / Math.max(better.outcome.time, 1e-9);
        const score = gap > 0 ? [1, -leads(better), shareOf(worse)] : [gap, later, -leads(better)];
        if (!most || isMore(score, most)) [best, most] = [[worse, better], score];
      }
  return best ?? [pool[0], pool[0]];
}

function isMore(score, other) {
  const place = score.findIndex((value, k) => value !== other[k]);
  return place >= 0 && score[place] > other[place];
}

/** What to show of a scenario, of any for "": with a policy, that one beside another. */
function opening(scenario = "", policy = "", start = "") {
  const within = kept((one) => (!scenario || one.scenario === scenario) &&
    (start === "" || String(one.start) === String(start)));
  if (!policy) return namesOf(contrast(within));
  const own = within.filter((one) => one.policy === policy);
  const pairs = own.map((one) => contrastWith(one, within)).filter(Boolean);
  const differing = pairs.find(([one, other]) => quality(one) !== quality(other));
  return namesOf(differing ?? pairs[0] ?? [own[0], own[0]]);
}

/** A recording beside the policy of its start that leads, or else differs from it. */
function contrastWith(own, recordings) {
  const others = recordings.filter((one) => one.policy !== own.policy &&
    one.scenario === own.scenario && one.start === own.start);
  const order = (one) => [
    Math.abs(quality(one) - quality(own)), !isReference(one), shareOf(one),
  ].map(Number);
  if (!others.length) return null;
  const other = others.reduce((a, b) => (isMore(order(b), order(a)) ? b : a));
  return quality(own) > quality(other) ? [other, own] : [own, other];
}

function namesOf(pair) {
  const [{ scenario, start }] = pair;
  return { scenario, start, policies: pair.map(({ policy }) => policy) };
}

// ---- the address --------------------------------------------------------------------------------

/** The part of an address after # that shows this. */
function fragmentOf({ scenario, start, policies, robot, time }) {
  const said = new URLSearchParams({ scenario });
  if (start !== undefined) said.set("start", start);
  for (const policy of policies) said.append("policy", policy);
  if (robot) said.set("robot", robot);
  if (time !== undefined) said.set("t", time.toFixed(2));
  return `#${said}`;
}

/** What the address asks for, where the page has it; null if it asks for nothing that is there. */
function asked() {
  const said = new URLSearchParams(location.hash.slice(1));
  const [scenario, start] = [said.get("scenario"), said.get("start") ?? ""];
  const has = (policy) => kept((one) => one.scenario === scenario && one.policy === policy &&
    (start === "" || String(one.start) === start)).length > 0;
  if (!kept((one) => one.scenario === scenario && (start === "" || String(one.start) === start))
    .length) return null;
  const policies = said.getAll("policy").filter(has);
  const found = opening(scenario, policies[0], start);
  if (policies.length > 1) found.policies = policies.slice(0, 2);
  if (start === "" && policies.length > 1)
    found.start = kept((one) => one.scenario === scenario && one.policy === policies[0])[0].start;
  if (policies.length === 1) found.side = found.policies.indexOf(policies[0]);
  const number = (name) => (Number.isFinite(Number(said.get(name))) ? Number(said.get(name)) : 0);
  return { ...found, robot: number("robot"), time: said.has("t") ? number("t") : undefined };
}
