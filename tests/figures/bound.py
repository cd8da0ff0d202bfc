"""Places and counts of light contacts that the noise of a readout allows, on a skin as simple as possible.

    python3 tests/figures/bound.py [--trials 150] [--offsets 0.19,0.1,0.05] [--model 0.05] [--noise 1] [--frames 30]
        [--power 1.8] [--spread 0.4] [--misplaced 0] [--missized 0] [--seed 5]

Needs numpy; a minute for 300 trials on one core. Means have 95 % intervals: right counts of 150 trials are known to
8 points, of 600 to 4. The sheet is uniform, with the electrodes of sensors/ert-28.toml; a contact is a current, scaled
so that 9.81 N make a frame of 2.6 mV (the median over the skin, root mean square). It grows with a power of the force
(--power), and differs between places 40 mm apart by a factor whose logarithm has the standard deviation --spread: by
default as on gap c, which has 0.73 mV at 4.9 N. With 1 and 0 a weight of 4.9 N is half as strong as one of 9.81 N,
everywhere. Trials are those of touch-real-random: 2 to 4 weights of 4.9, 7.4 and 9.8 N, 40 mm apart, means of 30 frames
(--frames) with white noise in each (--noise, mV), and offsets that are left after the untouched frame, as differences of the
buffers of neighbouring electrodes (mV per pair, --offsets). Contacts are searched as `exact` does: evidence by
Laplace's approximation, the same priors. The search knows the sheet, the law, the strength of each place, and the
covariance of the noise (`all`) or its variances alone (`size`), and a model error in proportion to the signal
(--model). Right counts are printed for all trials, and by the distance of the two closest contacts. --misplaced (mm)
and --missized (share of the current) are errors of a model that contacts imitate, which no search can know: by default
there are none.
"""

import argparse
import itertools
import math
import pathlib
import tomllib

import numpy as np

SENSOR = pathlib.Path(__file__).resolve().parents[2] / "experiments" / "sensors" / "ert-28.toml"
NODES, ELECTRODES = 46, 28
FRAME_MV, FRAME_N, FIELD_MM = 2.6, 9.81, 40.0
WEIGHTS_N, APART_MM, EDGE_MM = [4.905, 7.358, 9.81], 40, 20
# Ends of the ranges of spacing, the distance of the two closest contacts, by which right counts are printed.
SPACINGS_MM = [0, 60, 120, math.inf]
# Priors of `exact` (sim-core, FitOptions).
LN_FORCE, LN_FORCE_SD, LN_ODDS, LEAST_MM, MOST, HOPELESS = math.log(10.0), 0.8, -1.0, 20.0, 6, 16.0
BEAM, PICKS, PICKS_APART_MM, STEPS = 2, 4, 30.0, 15


def around(values):
    """Differences of neighbouring electrodes."""
    return values - np.roll(values, -1, axis=-1)


class Sheet:
    """Frames of contacts, reduced without loss: the mean of each pair of electrodes, and the part of all forces."""

    def __init__(self, law, spread, random):
        self.law = law
        sensor = tomllib.loads(SENSOR.read_text())
        self.size = np.array([sensor["width_mm"], sensor["height_mm"]])
        self.step = self.size / (NODES - 1)
        places = self.electrodes(sensor)
        nodes = [tuple(np.rint(place / self.step).astype(int)) for place in places]
        index = [x * NODES + y for x, y in nodes]
        potential = np.linalg.inv(self.conductance())[:, index]
        offset = around(potential[index])
        mean = offset.mean(0)
        pairs = (around(potential) - mean).reshape(NODES, NODES, ELECTRODES)
        total = np.linalg.norm(offset - mean) / math.sqrt(ELECTRODES)
        # The numbers of a current of 1 at each node: the pairs, and the part of all forces.
        self.grid = np.dstack([pairs, np.full((NODES, NODES), -total)])
        sites = [self.size * share for share in itertools.product((0.28, 0.5, 0.74), repeat=2)]
        frames = [np.linalg.norm(self.at(*site)[0]) / math.sqrt(ELECTRODES) for site in sites]
        self.grid *= FRAME_MV / np.median(frames) * self.strength(spread, random)[:, :, None]
        axes = [np.arange(EDGE_MM, size - EDGE_MM + 1, 20.0) for size in self.size]
        self.sites = np.array(list(itertools.product(*axes)))
        self.shapes = np.array([self.at(*site)[0] for site in self.sites])

    @staticmethod
    def electrodes(sensor):
        """Places of the electrodes in their order, mm."""
        rows, pitch = sensor["electrodes"], math.sqrt(3) / 2 * sensor["tip_diameter_mm"]
        first = (sensor["width_mm"] - (sensor["points"]["columns"] - 0.5) * pitch) / 2
        for row, (y, columns) in enumerate(zip(rows["rows_y_mm"], rows["columns"])):
            for column in columns[::-1] if row % 2 else columns:
                yield np.array([first + pitch * column, y])

    def strength(self, spread, random):
        """Factor of each node on the current, without trend along the edges."""
        length, wide = FIELD_MM / self.step, 2 * NODES
        waves = [math.tau * each * np.fft.fftfreq(wide) for each in length]
        smooth = np.exp(-(waves[0][:, None] ** 2 + waves[1][None, :] ** 2) / 4)
        field = np.fft.ifft2(np.fft.fft2(random.standard_normal((wide, wide))) * smooth).real
        return np.exp(spread * (field / field.std())[:NODES, :NODES])

    def conductance(self):
        """Of the sheet's nodes, with a reference that no difference depends on."""
        matrix = np.full((NODES**2, NODES**2), 1.0 / NODES**2)
        across = self.step[1] / self.step[0]
        for x, y in itertools.product(range(NODES), repeat=2):
            for to, value in [((x + 1, y), across), ((x, y + 1), 1 / across)]:
                if max(to) < NODES:
                    pair = np.array([x * NODES + y, to[0] * NODES + to[1]])
                    matrix[np.ix_(pair, pair)] += value * np.array([[1, -1], [-1, 1]])
        return matrix

    def at(self, x_mm, y_mm):
        """Numbers of the current of `FRAME_N` at a place, and their slopes per mm."""
        fine = np.array([x_mm, y_mm]) / self.step
        x, y = np.clip(fine.astype(int), 0, NODES - 2)
        a, b = fine - (x, y)
        v00, v10, v01, v11 = (self.grid[x + i, y + j] for i, j in [(0, 0), (1, 0), (0, 1), (1, 1)])
        value = (1 - a) * (1 - b) * v00 + a * (1 - b) * v10 + (1 - a) * b * v01 + a * b * v11
        along_x = ((1 - b) * (v10 - v00) + b * (v11 - v01)) / self.step[0]
        along_y = ((1 - a) * (v01 - v00) + a * (v11 - v10)) / self.step[1]
        return value, along_x, along_y

    def frame(self, contacts):
        """Reduced frame of contacts (x, y, ln F), and its slopes."""
        frame, slopes = np.zeros(ELECTRODES + 1), np.zeros((ELECTRODES + 1, contacts.size))
        for i, (x, y, ln_force) in enumerate(contacts):
            strength = (math.exp(ln_force) / FRAME_N) ** self.law
            value, along_x, along_y = (strength * of for of in self.at(x, y))
            frame += value
            slopes[:, 3 * i : 3 * i + 3] = np.column_stack([along_x, along_y, self.law * value])
        return frame, slopes


def covariance(sheet_frame, mean_noise_mv, offset_mv, model, knows_all):
    """Of a reduced mean of frames with this white noise, mV^2."""
    pairs = np.eye(ELECTRODES)
    neighbours = np.roll(pairs, 1, 0) + np.roll(pairs, -1, 0) if knows_all else 0 * pairs
    each = mean_noise_mv**2 / ELECTRODES + model**2 * (sheet_frame[:-1] ** 2).mean()
    whole = np.diag(np.append(np.full(ELECTRODES, each), each))
    whole[:-1, :-1] += offset_mv**2 * (pairs - neighbours / 2)
    return whole


class Search:
    """The search of `exact` in one frame."""

    def __init__(self, sheet, frame, error):
        self.sheet, self.whiten = sheet, np.linalg.inv(np.linalg.cholesky(error))
        self.frame, self.shapes = self.whiten @ frame, sheet.shapes @ self.whiten.T
        self.low = np.array([EDGE_MM / 2, EDGE_MM / 2, -1.2])
        self.high = np.append(sheet.size - EDGE_MM / 2, 5.0)
        self.precision = np.append(12 / (self.high - self.low)[:2] ** 2, LN_FORCE_SD**-2)

    def residual(self, contacts):
        """Cost, residual and slopes, whitened."""
        frame, slopes = self.sheet.frame(contacts)
        residual = self.frame - self.whiten @ frame
        prior = (((contacts[:, 2] - LN_FORCE) / LN_FORCE_SD) ** 2).sum()
        return residual @ residual + prior, residual, self.whiten @ slopes

    def descend(self, contacts):
        """-2 ln evidence at the optimum, and its contacts."""
        contacts = np.clip(contacts, self.low, self.high)
        count, damping = len(contacts), 1e-3
        prior = np.diag(np.tile(self.precision, count))
        cost, residual, slopes = self.residual(contacts)
        for _ in range(STEPS if count else 0):
            normal, gradient = slopes.T @ slopes + prior, slopes.T @ residual
            gradient[2::3] += (LN_FORCE - contacts[:, 2]) * self.precision[2]
            step = np.linalg.solve(normal + damping * np.diag(np.diag(normal)), gradient)
            step /= max(1.0, np.max(np.abs(step) / np.tile([25.0, 25.0, 0.7], count)))
            moved = np.clip(contacts + step.reshape(-1, 3), self.low, self.high)
            found = self.residual(moved)
            if found[0] < cost:
                gained, contacts, (cost, residual, slopes) = cost - found[0], moved, found
                damping = max(0.2 * damping, 1e-9)
                if gained < 0.05:
                    break
            elif (damping := 5 * damping) > 1e4:
                break
        area = np.prod((self.high - self.low)[:2])
        each = math.log(LN_FORCE_SD**2) + 2 * math.log(area) - 2 * math.log(math.tau) - 2 * LN_ODDS
        width = np.linalg.slogdet(slopes.T @ slopes + prior)[1] if count else 0.0
        return cost + count * each - 2 * math.lgamma(count + 1) + width, contacts

    def grown(self, contacts):
        """Optima with one further contact, at the sites with the largest gain."""
        _, residual, slopes = self.residual(contacts)
        shapes = self.shapes
        if len(contacts):
            known, _ = np.linalg.qr(slopes)
            residual = residual - known @ (known.T @ residual)
            shapes = shapes - (shapes @ known) @ known.T
        own = np.maximum((shapes**2).sum(1), 1e-3 * (self.shapes**2).sum(1))
        along = np.maximum(shapes @ residual, 0.0)
        gain, sites = along**2 / own, self.sheet.sites
        for _ in range(PICKS):
            best = int(np.argmax(gain))
            if gain[best] <= 0:
                return
            force = np.clip(math.log(FRAME_N) + math.log(along[best] / own[best]) / self.sheet.law, 0.7, 4.1)
            gain[np.hypot(*(sites - sites[best]).T) < PICKS_APART_MM] = 0.0
            score, grown = self.descend(np.vstack([contacts, [*sites[best], force]]))
            if closest_mm(grown) >= LEAST_MM:
                yield score, grown

    def run(self):
        """The most probable contacts."""
        level = [self.descend(np.zeros((0, 3)))]
        best = level[0]
        for _ in range(MOST):
            children = [child for _, parent in level[:BEAM] for child in self.grown(parent)]
            level = []
            for child in sorted(children, key=lambda child: child[0]):
                if all(abs(child[0] - other[0]) > 1e-2 for other in level):
                    level.append(child)
            if not level or level[0][0] > best[0] + HOPELESS:
                break
            best = min(best, level[0], key=lambda found: found[0])
        return best[1]


def closest_mm(contacts):
    """Distance of the two closest contacts."""
    pairs = itertools.combinations(contacts[:, :2], 2)
    return min((math.dist(a, b) for a, b in pairs), default=math.inf)


def matched_mm(found, truth):
    """Distances within the pairs with the least sum."""
    few, many = sorted([found, truth], key=len)
    apart = np.hypot(*(few[:, None, :2] - many[None, :, :2]).transpose(2, 0, 1))
    orders = itertools.permutations(range(len(many)), len(few))
    return list(min((apart[range(len(few)), order] for order in orders), key=np.sum))


def trial(sheet, count, random):
    """Weights on a skin."""
    while True:
        places = random.uniform(EDGE_MM, sheet.size - EDGE_MM, (count, 2))
        contacts = np.column_stack([places, np.log(random.choice(WEIGHTS_N, count))])
        if closest_mm(contacts) >= APART_MM:
            return contacts


def shifted(contacts, misplaced_mm, missized, law, random):
    """Contacts with the frame that a model with these errors, standard deviations, takes for that of `contacts`."""
    sd = [misplaced_mm, misplaced_mm, missized / law]
    return contacts + random.standard_normal(contacts.shape) * sd


def interval(values):
    """A mean with its 95 % interval, of values taken as independent."""
    half = 1.96 * np.std(values) / math.sqrt(len(values))
    return f"{np.mean(values):.3g} [{np.mean(values) - half:.3g}, {np.mean(values) + half:.3g}]"


def main():
    """Prints a row for each size of the offsets and what is known of them."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--trials", type=int, default=150)
    parser.add_argument("--offsets", default="0.19,0.1,0.05", help="mV per pair of electrodes")
    parser.add_argument("--model", type=float, default=0.05, help="error of the model, share of the signal")
    parser.add_argument("--noise", type=float, default=1.0, help="white noise of a voltage in one frame, mV")
    parser.add_argument("--frames", type=int, default=30, help="frames in a mean")
    parser.add_argument("--power", type=float, default=1.8, help="power of the force in a contact's current")
    parser.add_argument("--spread", type=float, default=0.4, help="standard deviation of ln of a place's strength")
    parser.add_argument("--misplaced", type=float, default=0.0, help="error of each place, standard deviation, mm")
    parser.add_argument("--missized", type=float, default=0.0, help="error of each current, as a share")
    parser.add_argument("--seed", type=int, default=5)
    args = parser.parse_args()
    mean_noise_mv = args.noise / math.sqrt(args.frames)
    sheet = Sheet(args.power, args.spread, np.random.default_rng(args.seed + 1))
    print("| offsets, mV | known of them | location, mm | closest, mm | number, % | right count, % | under 60 mm | to 120 mm "
          "| above |\n|" + "---|" * 9)
    for offset_mv in map(float, args.offsets.split(",")):
        for known in ["size", "all"]:
            # Separate, so that trials and noise are the same with and without errors of the model.
            random, errors = (np.random.default_rng(args.seed + more) for more in [0, 2])
            location, closest, number, right, spacing = [], [], [], [], []
            for index in range(args.trials):
                truth = trial(sheet, 2 + index % 3, random)
                clean, _ = sheet.frame(shifted(truth, args.misplaced, args.missized, args.power, errors))
                true_error = covariance(clean, mean_noise_mv, offset_mv, args.model, True)
                frame = clean + np.linalg.cholesky(true_error) @ random.standard_normal(len(clean))
                assumed = covariance(clean, mean_noise_mv, offset_mv, args.model, known == "all")
                found = Search(sheet, frame, assumed).run()
                location += matched_mm(found, truth)
                apart = np.hypot(*(truth[:, None, :2] - found[None, :, :2]).transpose(2, 0, 1))
                closest += list(apart.min(1)) if len(found) else []
                number.append(100 * (len(found) / len(truth) - 1))
                right.append(100.0 * (len(found) == len(truth)))
                spacing.append(closest_mm(truth))
            ranges = [[of for of, mm in zip(right, spacing) if low <= mm < high]
                      for low, high in itertools.pairwise(SPACINGS_MM)]
            means = [interval(values) if values else "-" for values in [location, closest, number, right, *ranges]]
            print(f"| {offset_mv} | {known} | {' | '.join(means)} |", flush=True)


if __name__ == "__main__":
    main()
