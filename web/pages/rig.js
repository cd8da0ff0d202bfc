// The rig: can it move, and what is wrong with it? Its devices in a chain from wire to tip, its actions with the
// reason where one cannot be done, jog while a button is held, the check, and the pose to copy.

import { hold } from '../lib/address.js'
import { get } from '../lib/api.js'
import { actOnRig, actor, endMotion, outcome, refusal, sendNow, sureHome } from '../lib/actions.js'
import { chain, lastWord, stopWords, stoppingWords, streamWords, wireWords } from '../lib/chain.js'
import { copyButton } from '../lib/copybutton.js'
import { el, every, facts, fill, panel, renew, say, select } from '../lib/dom.js'
import { capital, count, fixed, listed, moment, plain } from '../lib/format.js'
import { forceBars } from '../lib/forces.js'
import { jog, stepsOf } from '../lib/jog.js'
import { live, who } from '../lib/live.js'
import { lockWords } from '../lib/lock.js'
import { checkReport } from '../lib/rigcheck.js'
import { motionWords, withMotion } from '../lib/runwords.js'
import { meaning } from '../lib/vocabulary.js'
import { TONE } from '../lib/words.js'

// What the devices of a rig say when its wires are opened, and more.
const DEVICES_TOLD = 50
const CHECK_MS = 120_000, RATES_MS = 2000, SURE_S = 8
const ACTIONS = [['connect', 'Connect', 'Opens the wires and asks every device who it is.'],
  ['home', 'Home', 'Homes each axis, z first. The axes move.'],
  ['tare', 'Tare', 'Takes the present output of the cells as zero: z must be homed and up, and nothing may touch the tips.'],
  ['reset', 'Reset', 'Acknowledges the trip after its cause is cleared. Nothing moves.'], ['disconnect', 'Disconnect', 'Closes the wires.']]

/** Why this caller cannot do an action of the rig now, as words; '' if it can. */
function forbidden(action, status, fresh) {
  if (!fresh) return 'No connection.'
  if (!live.may('operator')) return 'It needs the role operator.'
  // A held button requests the next jog before the status shows the end of the one before.
  if (live.motion && action !== 'jog') return 'The rig moves.'
  const words = refusal(status, action)
  return lockWords() || words && `${capital(words)}.`
}

/** Shows the page. */
export async function show(root, { query, signal, set }) {
  const state = { steps: stepsOf(query), found: {}, limits: null, shown: '', rates: null }
  const said = outcome(), saidTips = outcome(), saidCheck = outcome(), links = chain()
  const head = el('p', { className: 'state' }), sentence = el('p'), acts = el('ul', { className: 'acts' }), pose = el('div'),
    copy = el('pre', { tabIndex: 0 }), limits = el('div'), trip = el('div', { className: 'trip', hidden: true })
  const halt = actor('Stop this motion', said, endMotion, { role: 'viewer', done: 'accepted', className: 'danger', title: 'The axes stop, then the tips rise' })
  const bars = forceBars({ signal })
  const may = action => live.status ? forbidden(action, live.status, live.fresh) : 'No status yet.'
  const pad = jog({ allowed: () => may('jog'), steps: () => state.steps, signal,
    choose(change) {
      const { xy, z } = Object.assign(state.steps, change)
      set({ step: xy === '0.5' ? null : xy, stepz: z === '0.1' ? null : z })
    } })

  const rows = ACTIONS.map(([action, words, about]) => {
    const why = el('span', { className: 'soft' }), one = actor(words, said, () => actOnRig(action), action === 'home' ? { sure: sureHome, done: 'accepted' } : {})
    return { action, about, why, one, node: el('li', {}, one, why) }
  })
  fill(acts, rows.map(row => row.node))

  // Tips: the number that a person mounted, on arms 1 to n.
  const tipsWhy = el('span', { className: 'soft' }), tipsChoice = select([0, 1, 2, 3, 4, 5, 6], live.status?.rig.tips ?? 0,
    value => chooseTips(value), { id: 'rig-tips' })
  const tipsEnter = actor('Enter', saidTips, async () => {
    await actOnRig('tips', { tips: Number(tipsChoice.value) })
    chooseTips('') // What was entered is what the rig reports from now on.
  }, { what: 'Tips' })
  const writeTips = hold('tips', { take: text => { if (/^[0-6]$/.test(text)) Object.assign(tipsChoice, { value: text }).dataset.chosen = 'yes' },
    text: () => tipsChoice.dataset.chosen ? tipsChoice.value : null, signal })
  function chooseTips(value) {
    tipsChoice.dataset.chosen = value && 'yes'
    writeTips()
  }

  // The check: a report of every device; the rig must be disconnected.
  // Whether the servos are switched on is not in the address: a link must not choose it.
  const report = el('div'), enable = el('input', { type: 'checkbox', id: 'rig-enable' }), checkWhy = el('span', { className: 'soft' })
  const checkNow = actor('Check every device', saidCheck, async () => {
    fill(report, el('p', { className: 'soft' }, 'Asking every device; this takes some seconds …'))
    try {
      fill(report, checkReport(await sendNow('/rig/check', { enable: enable.checked, who: who() }, { wait: CHECK_MS, signal })))
    } catch (error) {
      fill(report)
      throw error
    }
  }, { what: 'Check' })

  const toCopy = copyButton(() => copy.textContent)

  // What would be refused is not offered: a viewer sees the state alone.
  const viewer = el('p', { className: 'soft' }, 'You see what the rig does. To act you need the key of an operator.')
  const showRole = () => {
    const has = action => live.status?.rig_actions.some(one => one.action === action) ?? true
    for (const [node, action] of [[acts], [pad.node, 'jog'], [tips, 'tips'], [checks]]) node.hidden = !live.may('operator') || Boolean(action) && !has(action)
    for (const row of rows) row.node.hidden = !has(row.action)
    viewer.hidden = live.may('operator')
  }
  const tips = panel('Tips', {}, el('div', { className: 'row' }, el('label', { className: 'inline', htmlFor: 'rig-tips' }, 'Mounted on arms 1 to'),
    tipsChoice, tipsEnter), tipsWhy, saidTips.node)
  const checks = panel('Check', {}, el('p', {}, 'Asks every device, reads the cells and the stream, and moves nothing.'),
    el('div', { className: 'row' }, checkNow, el('label', { className: 'inline', htmlFor: 'rig-enable' }, enable,
      'also switch the servos on (they stay on)')), checkWhy, saidCheck.node, report)

  root.append(el('div', { className: 'columns wide-right' },
    el('div', { className: 'column' },
      panel('Can it move?', { className: 'live' }, el('div', { className: 'headline' }, head, halt), sentence, trip, viewer, acts, said.node),
      panel('Jog', { className: 'live' }, pose, pad.node),
      tips,
      panel('Teach', { className: 'live' }, el('p', {}, 'The present pose in machine coordinates, to copy into the rig file.'), copy, toCopy),
      panel('Test of the stop', {}, el('ol', { className: 'steps' },
        ['Home the rig, and let it travel: jog x while a person watches.', 'Press Stop in the top bar while it moves. It asks nothing.',
        'Read here how long every axis took to acknowledge, and check that it has stopped.',
        'Reset, then home. Do the same with the button on the rig, which removes the power.'].map(words => el('li', {}, words))),
          el('p', { className: 'soft' }, 'This stop is software: it asks the drives to stop. A rig that can injure a person needs the one in hardware.'))),
    el('div', { className: 'column' }, panel('From wire to tip', { className: 'live' }, links.node),
      checks,
      panel('Limits', {}, limits))))

  function gate(node, why, words) {
    node.disabled = Boolean(why) || node.dataset.busy === 'yes'
    return words ? say(words, why) : undefined
  }

  function drawTrip(rig) {
    trip.hidden = !rig.trip
    if (rig.trip) fill(trip, el('p', { className: 'bad' }, `Tripped (${plain(rig.trip.kind)})${rig.trip.detail && `: ${rig.trip.detail}`}.`),
      el('p', {}, meaning('trips', rig.trip.kind)))
  }

  function draw({ status, fresh, motion }) {
    if (!status) return
    const { run } = status, closed = status.rig.state === 'disconnected', { stream } = status.rig
    // The status keeps what was read last: with closed wires it is not the present pose.
    const rig = closed ? { ...status.rig, pose: null, forces_n: [], live_cells: null, wires: [], stream: { ...stream, frames: 0 } } : status.rig
    if (state.closed && !closed) listen()
    bars.hidden = state.closed = closed
    say(head, withMotion(run ? `${plain(rig.state)}, run ${run.scan_id}` : plain(rig.state), motion))
    head.className = `state ${TONE[rig.state] ?? ''}`
    // With its place kept, or what is below would move with each jog. A motion for a run ends with that run.
    halt.style.visibility = motion && !run ? '' : 'hidden'
    halt.inert = !fresh
    say(sentence, run ? `${run.experiment} is ${plain(run.state)}${run.waiting_for ? `: ${run.waiting_for}` : ''}.` : motion ? motionWords(motion) : rig.has_stage === false
      && rig.state === 'disarmed' ? 'Connected. There is nothing to home: a run may start.' : meaning('rig_states', rig.state))
    showRole()
    drawTrip(rig)
    for (const { action, about, why, one } of rows) gate(one, may(action), null) ?? say(why, may(action) || about)
    gate(tipsEnter, may('tips'))
    if (!tipsChoice.dataset.chosen && rig.tips != null) tipsChoice.value = rig.tips
    say(tipsWhy, may('tips') || (rig.tips == null ? 'No number was entered since the start: without one the connected cells count.'
      : `${rig.tips} entered; the cells must agree.`))
    gate(checkNow, may('check'), checkWhy)
    pad.gate()
    drawPose(rig.pose)
    links.show(devices(rig, status.needs))
    if (!fresh) return
    drawLimits(rig)
  }

  function drawPose(at) {
    const text = JSON.stringify(at ?? null)
    if (state.shown === text) return
    state.shown = text
    fill(pose, !at ? el('p', { className: 'soft' }, 'The pose is not known while the wires are closed.')
      : facts([['x', fixed(at.x_mm, 2, 'mm')], ['y', fixed(at.y_mm, 2, 'mm')], ['z, downwards', fixed(at.z_mm, 2, 'mm')],
        ['Radius', fixed(at.radius_mm, 2, 'mm')]]))
    const keys = ['x_mm', 'y_mm', 'z_mm', 'radius_mm'].map(key => at && `${key} = ${at[key].toFixed(3)}`)
    say(copy, at ? [`# pose of ${live.status.rig.name}, ${new Date().toISOString()}`, ...keys].join('\n') : '# connect first')
    toCopy.disabled = !at
  }

  /** The chain: wires, stream, axes, stop, cells, tips, skin. */
  function devices(rig, needs) {
    const closed = rig.state === 'disconnected', moves = rig.has_stage !== false
    const wires = rig.wires.map(wire => ({ name: `Wire ${wire.name}`, ...wireWords(wire, rateOf(state.rates?.wires.find(one => one.name === wire.name))) }))
    const axis = (name, key, unit = 'mm') => ({ name: key === 'radius' ? 'Arms (radial axis)' : `Axis ${name}`, words: closed ? 'Closed.'
      : lastWord(state.found[name]) || 'It has not reported yet.',
      figures: rig.pose ? [['Position', fixed(rig.pose[`${key}_mm`], 2, unit)], ['Known', ['homed', 'armed'].includes(rig.state) ? 'homed' : 'not homed']]
        : [] })
    const dead = rig.forces_n.slice(0, rig.tips ?? 0).flatMap((force, i) => force == null ? [i + 1] : [])
    const cells = { name: 'Load cells', inside: bars, tone: dead.length ? 'bad' : '', words: closed ? 'Closed.'
      : listed([lastWord(state.found.cells), dead.length ? `no output on arm ${dead.join(', ')}: check its cable` : '', rig.live_cells == null ? ''
      : `${rig.live_cells} of 6 connected`], '; ') || 'No word yet.' }
    const { surface } = rig
    const tips = { name: 'Tips and surface', words: rig.tips == null ? 'No number of tips was entered.'
      : `${count(rig.tips)} mounted${rig.tips ? ` on arms 1 to ${rig.tips}` : ''}.`, figures: surface
      ? [['Surface', fixed(surface.surface_z_mm, 2, 'mm')], ['Found', `${moment(surface.at)} with ${surface.tips} tips`]]
      : [['Surface', 'not searched for yet']] }
    return [...wires, { name: 'Voltage stream', ...streamWords(rig.stream, rateOf(state.rates?.stream), rig) },
      ...(moves ? [axis('x', 'x'), axis('y', 'y'), axis('z', 'z'), axis('radial', 'radius'), { name: 'Stop', ...stopWords(rig, needs) },
        { name: 'Stopping distance', ...stoppingWords(rig.stopping) }, cells, tips] : [])]
  }

  function drawLimits(rig) {
    const rows = [rig.force_limit_n != null && ['Force on one cell', fixed(rig.force_limit_n, 0, 'N')], ...(state.limits ?? [])].filter(Boolean)
    renew(limits, rows, () => [facts(rows), el('p', { className: 'soft' }, state.limits ? 'From the rig file, which was read at the start of the service.'
      : 'The other limits are in the rig file.')])
  }

  get('/rig/limits', {}, { signal }).then(({ frame_age_ms, bench }) => {
    // A number, or a range; a skin alone has the age of a frame only.
    const row = (words, value, unit) => value != null && [words, `${[value].flat().join(' to ')}\u202f${unit}`]
    state.limits = [row('Sum of forces', bench?.force_sum_n, 'N'), row('Margin for a stop', bench?.force_margin_n, 'N'),
      row('Margin of the sum', bench?.force_sum_margin_n, 'N'), row('Drift of a tare', bench?.tare_drift_n, 'N'),
      row('Age of a sample', bench?.sample_age_ms, 'ms'), row('Age of a frame', frame_age_ms, 'ms'),
      ...['x', 'y', 'z'].map(name => row(`Travel of ${name}`, bench?.[`${name}_mm`], 'mm')), row('Radius', bench?.radius_mm, 'mm'),
      row('Surface', bench?.surface_z_mm, 'mm'), row('Clearance', bench?.clearance_mm, 'mm')]
    draw(live)
  }, () => {})
  // While nothing has changed in the first seconds, no rate is shown: the counters of the wires are read every few seconds.
  function rateOf(change) {
    const over_s = state.rates?.over_s ?? 0
    const isQuiet = !change || Object.values(change).every(value => typeof value !== 'number' || value === 0)
    return over_s === 0 || over_s < SURE_S && isQuiet ? null : { over_s, ...change }
  }
  every(RATES_MS, async () => {
    if (live.status?.rig.state === 'disconnected') return
    state.rates = await get('/rig/rates', {}, { signal }).catch(() => state.rates)
    if (!signal.aborted) draw(live)
  }, signal)
  // What each device said when the wires were opened last.
  const listen = () => get('/events', { kind: 'device', since: -DEVICES_TOLD }, { signal }).then(({ items }) => {
    for (const event of items) state.found[event.data.device] = event
    draw(live)
  }, () => {})
  listen()
  live.on('status', draw, signal)
  live.on('fresh', draw, signal)
  live.addEventListener('caller', () => { showRole(); draw(live) }, { signal })
  showRole()
  return { update(next) { Object.assign(state.steps, stepsOf(next)); pad.follow() } }
}
