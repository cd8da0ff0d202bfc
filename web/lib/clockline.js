// A line of time that shows when queued runs begin and end.

import { el, fill } from './dom.js'
import { clock, moment } from './format.js'

const STEPS_MIN = [1, 2, 5, 10, 15, 30, 60, 120, 180, 360, 720, 1440, 2880, 10_080]

/** Full steps of local time between two moments, at most eight. */
function ticks(from, to) {
  const step = (STEPS_MIN.find(min => (to - from) / (min * 6e4) <= 8) ?? 10_080) * 6e4
  const zone = new Date(from).getTimezoneOffset() * 6e4
  const all = []
  for (let t = Math.ceil((from - zone) / step) * step + zone; t < to; t += step) all.push(t)
  return all
}

/** A line of time: `show(now, bars)`, bars [{ name, href, begin, end, tone? }] in order. */
export function clockline() {
  const track = el('div', { className: 'clock-track' })
  const scale = el('div', { className: 'clock-scale', 'aria-hidden': 'true' })
  const node = el('div', { className: 'clockline', role: 'group', 'aria-label': 'Predicted times of the runs' }, track, scale)
  function show(now, bars) {
    node.hidden = !bars.length
    if (!bars.length) return
    const from = now
    const to = Math.max(...bars.map(bar => bar.end)) + Math.max(60_000, (Math.max(...bars.map(bar => bar.end)) - now) * 0.03)
    const part = t => `${Math.max(0, Math.min(100, ((t - from) / (to - from)) * 100))}%`
    // Named, and a link, where a finger hits it on a phone; the table below leads to the others.
    const wide = bar => (bar.end - bar.begin) / (to - from) > 0.08
    fill(track,
      bars.map((bar, i) =>
        el(
          wide(bar) ? 'a' : 'span',
          {
            ...(wide(bar) ? { href: bar.href } : { role: 'img' }),
            className: `clock-bar ${bar.tone ?? (i % 2 ? 'even' : 'odd')}`,
            'aria-label': `${bar.name}: ${moment(bar.begin)} to ${moment(bar.end)}`,
            title: `${bar.name}: ${moment(bar.begin)} to ${moment(bar.end)}`,
            style: { left: part(bar.begin), width: `max(3px, calc(${part(bar.end)} - ${part(bar.begin)}))` },
          },
          wide(bar) ? bar.name : '',
        ),
      ),
    )
    const days = to - from > 864e5
    const last = t => t === from
    fill(scale,
      [from, ...ticks(from, to).filter(t => (t - from) / (to - from) > 0.06 && (t - from) / (to - from) < 0.88)].map(t =>
        el('span', { style: { left: part(t) } }, last(t) ? 'now' : days ? moment(t).replace('tomorrow ', 'tom. ') : clock(t).slice(0, 5)),
      ),
    )
  }
  return { node, show }
}
