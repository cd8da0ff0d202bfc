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
    const end = Math.max(...bars.map(bar => bar.end))
    const whole = end + Math.max(60_000, (end - now) * 0.03) - now
    const share = t => (t - now) / whole
    const part = t => `${Math.max(0, Math.min(100, share(t) * 100))}%`
    // Named, and a link, where a finger hits it on a phone; the table below leads to the others.
    const bar = ({ name, href, begin, end, tone }, i) => {
      const words = `${name}: ${moment(begin)} to ${moment(end)}`
      const style = { left: part(begin), width: `max(3px, calc(${part(end)} - ${part(begin)}))` }
      const props = { className: `clock-bar ${tone ?? (i % 2 ? 'even' : 'odd')}`, 'aria-label': words, title: words, style }
      return (end - begin) / whole > 0.08 ? el('a', { href, ...props }, name) : el('span', { role: 'img', ...props })
    }
    fill(track, bars.map(bar))
    const moments = ticks(now, now + whole).filter(t => share(t) > 0.06 && share(t) < 0.88)
    const word = t => (whole > 864e5 ? moment(t).replace('tomorrow ', 'tom. ') : clock(t).slice(0, 5))
    fill(scale, [now, ...moments].map(t => el('span', { style: { left: part(t) } }, t === now ? 'now' : word(t))))
  }
  return { node, show }
}
