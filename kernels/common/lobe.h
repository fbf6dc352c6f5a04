/* Probability P that an outgoing direction of the model enters a receiver's sphere (docs/estimators.md).
 *
 * t_c = normalise((1 - alpha) t_m + alpha t_d), t_d with density max(0, n.t_d) / pi on the unit sphere. Before
 * it is normalised, the sum lies on a sphere of radius alpha about k t_m, k = 1 - alpha. That sphere is symmetric
 * about t_m: a t_d at colatitude gamma and azimuth psi from t_m gives a t_c at the same azimuth, at a colatitude
 * beta(gamma). So, in slices of equal azimuth,
 *
 *     P = 1/pi int dpsi int (n_z cos gamma + n_x cos psi sin gamma) sin gamma dgamma,
 *
 * azimuths counted from n's. The inner integral has a closed form. Its limits are the slice's ends: the rim of
 * the receiver's disc (sin theta = radius / distance), the lobe's edge sin beta_m = alpha / k where alpha < 1/2,
 * the horizon of the face, g.t_c = 0, and that of the normal, n.t_d = 0. No density is evaluated, so its infinite
 * value at the lobe's edge never shows, and every limit is met exactly. For alpha < 1/2 a direction inside the
 * lobe comes from two t_d, on the far (+) and on the near (-) side of the sphere.
 *
 * The outer integral is over t: with the disc's centre at colatitude beta_c outside the disc,
 * sin psi' = sin theta / sin beta_c sin t, psi' from the centre's azimuth; else t = psi' all around. The length of
 * a chord of the disc is then proportional to cos t. A disc that the lobe's edge does not cut is integrated by
 * the midpoint rule, which is spectral there; one that it cuts in up to three pieces, split where the edge cuts the
 * disc's rim, by the Gauss-Legendre rule in tau, t = middle - half-width x cos tau, which removes the square
 * roots at the pieces' ends. Discs far from every limit take the density in four directions instead
 * (smooth_probability), which costs a twentieth. */
#if !defined(CLR_PLAIN) || !defined(CLR_EDGE) || !defined(CLR_FINE)
#error "CLR_PLAIN, CLR_EDGE, CLR_FINE (nodes of the quadratures) are missing"
#endif

#include "common/phase.h"
#include "common/vector.h"

#define PI_F 3.14159265f

/* A sample's and a Tx's lobe. Frame: z along t_m, n in the plane of x and z. */
typedef struct {
    realw alpha, k;        /* k = 1 - alpha */
    realw n_z, n_x;        /* normal */
    realw g_x, g_y, g_z;   /* normal of the face, on the ray's side */
    realw edge, edge_cos;  /* sine and cosine of the lobe's edge; 1, 0 where there is none */
    intw two;              /* alpha < 1/2: every direction comes from two t_d, or none */
    int any_two;
} lobe;

/* A receiver's disc in that frame: centre direction as colatitude and azimuth. */
typedef struct {
    realw z, rho;          /* cosine and sine of the centre's colatitude */
    realw cos_psi, sin_psi;
    realw sine, cosine;    /* of the disc's half angle */
    intw around;           /* t_m or -t_m lies in the disc: every azimuth does */
    intw inside;           /* the sample lies in the sphere: every direction is in the disc */
    realw ratio;           /* sin theta / sin beta_c where not around */
} disc;

/* Angle of (x, y), y >= 0, from the x axis, 0 to pi. The polynomial is atan's on [0, 1] to 1e-7. */
static inline realw angle(realw y, realw x) {
    const realw size = x < 0.0f ? -x : x;
    const intw steep = y > size;
    const realw low = steep ? size : y, high = steep ? y : size;
    const realw z = low / (high + 1e-30f), q = z * z;
    realw p = fused(q, (realw)(-0.00469326084f), (realw)(0.0242523501f));
    p = fused(p, q, (realw)(-0.0594863206f));
    p = fused(p, q, (realw)(0.0991428791f));
    p = fused(p, q, (realw)(-0.140194792f));
    p = fused(p, q, (realw)(0.199697236f));
    p = fused(p, q, (realw)(-0.333319907f));
    p = fused(p, q, (realw)(0.999999901f)) * z;
    p = steep ? 0.5f * PI_F - p : p;
    return x < 0.0f ? PI_F - p : p;
}

/* int_1^2 (n_z cos gamma + m sin gamma) sin gamma dgamma between two angles given as cosine and sine. */
static inline realw flux(realw n_z, realw m, realw c1, realw s1, realw c2, realw s2) {
    const realw sine = s2 * c1 - c2 * s1, product = c1 * c2;
    const realw swept = angle(sine > 0.0f ? sine : (realw)(0.0f), product + s1 * s2);
    return 0.5f * (n_z * (s1 * c2 + c1 * s2) * sine + m * (swept - (product - s1 * s2) * sine));
}

/* Move an angle, given as cosine and sine, that is behind the horizon of n onto it. */
static inline void keep_above(realw n_z, realw m, realw horizon_cos, realw horizon_sin, realw *c,
                              realw *s) {
    const intw hidden = n_z * *c + m * *s < 0.0f;
    *c = choose(hidden, horizon_cos, *c);
    *s = choose(hidden, horizon_sin, *s);
}

/* The inner integral at the azimuth psi' from the disc's centre, given as cosine and sine. */
static inline realw slice(const lobe l, const disc d, realw cos_t, realw sin_t, intw clipped) {
    /* The chord: from its middle e, the disc's rim is at +-eta. */
    const realw off = d.rho * sin_t;
    const realw scale = 1.0f / square_root(1.0f - lesser(off * off, (realw)(0.999999f)));
    const realw e_z = d.z * scale, e_x = d.rho * cos_t * scale;
    const realw chord = (d.sine - off) * (d.sine + off);
    const realw sine = square_root(chord > 0.0f ? chord : (realw)(0.0f)) * scale, cosine = d.cosine * scale;
    realw z1 = e_z * cosine + e_x * sine, x1 = e_x * cosine - e_z * sine;
    realw z2 = e_z * cosine - e_x * sine, x2 = e_x * cosine + e_z * sine;
    const intw from_axis = (x1 < 0.0f) | d.inside, to_axis = (x2 < 0.0f) | d.inside;
    z1 = choose(from_axis, (realw)(1.0f), z1);
    x1 = choose(from_axis, (realw)(0.0f), x1);
    z2 = choose(to_axis, (realw)(-1.0f), z2);
    x2 = choose(to_axis, (realw)(0.0f), x2);

    const realw azimuth_x = d.cos_psi * cos_t - d.sin_psi * sin_t;
    intw empty = x1 != x1; /* none, but also NaN */
    if (ANYW(clipped)) {
        /* g.(z, x) = g_z z + across x changes its sign at (-across, g_z), turned to x >= 0. */
        const realw azimuth_y = d.sin_psi * cos_t + d.cos_psi * sin_t;
        const realw across = l.g_x * azimuth_x + l.g_y * azimuth_y;
        const realw norm = 1.0f / square_root(across * across + l.g_z * l.g_z + 1e-30f);
        const realw turned = l.g_z < 0.0f ? -norm : norm;
        const realw h_z = -across * turned, h_x = l.g_z * turned;
        const intw below1 = l.g_z * z1 + across * x1 <= 0.0f;
        const intw below2 = l.g_z * z2 + across * x2 <= 0.0f;
        empty |= below1 & below2;
        z1 = choose(below1, h_z, z1);
        x1 = choose(below1, h_x, x1);
        z2 = choose(below2, h_z, z2);
        x2 = choose(below2, h_x, x2);
    }
    if (l.any_two) {
        empty |= ((z1 <= 0.0f) | (x1 >= l.edge)) & l.two;
        const intw beyond = ((x2 > l.edge) | (z2 < l.edge_cos)) & l.two;
        z2 = choose(beyond, l.edge_cos, z2);
        x2 = choose(beyond, l.edge, x2);
    }

    /* gamma of both ends on both sheets. */
    const realw m = l.n_x * azimuth_x;
    const realw to_horizon = 1.0f / square_root(l.n_z * l.n_z + m * m + 1e-30f);
    const realw horizon_cos = -m * to_horizon, horizon_sin = l.n_z * to_horizon;
    const realw inverse = 1.0f / l.alpha;
    const realw square1 = (l.alpha - l.k * x1) * (l.alpha + l.k * x1);
    const realw square2 = (l.alpha - l.k * x2) * (l.alpha + l.k * x2);
    const realw root1 = square_root(square1 > 0.0f ? square1 : (realw)(0.0f));
    const realw root2 = square_root(square2 > 0.0f ? square2 : (realw)(0.0f));
    realw c1 = (z1 * root1 - l.k * x1 * x1) * inverse, s1 = x1 * (l.k * z1 + root1) * inverse;
    realw c2 = (z2 * root2 - l.k * x2 * x2) * inverse, s2 = x2 * (l.k * z2 + root2) * inverse;
    keep_above(l.n_z, m, horizon_cos, horizon_sin, &c1, &s1);
    keep_above(l.n_z, m, horizon_cos, horizon_sin, &c2, &s2);
    realw sum = flux(l.n_z, m, c1, s1, c2, s2);
    if (l.any_two) {
        c1 = (-z1 * root1 - l.k * x1 * x1) * inverse;
        s1 = x1 * (l.k * z1 - root1) * inverse;
        c2 = (-z2 * root2 - l.k * x2 * x2) * inverse;
        s2 = x2 * (l.k * z2 - root2) * inverse;
        keep_above(l.n_z, m, horizon_cos, horizon_sin, &c1, &s1);
        keep_above(l.n_z, m, horizon_cos, horizon_sin, &c2, &s2);
        sum += choose(l.two, flux(l.n_z, m, c2, s2, c1, s1), (realw)(0.0f));
    }
    return choose(empty, (realw)(0.0f), sum);
}

/* The integrand over t. */
static inline realw at_angle(const lobe l, const disc d, realw t, intw clipped) {
    realw cos_t, sin_t;
    cos_sin_cycles(t * (0.5f / PI_F), &cos_t, &sin_t);
    const realw sin_off = d.ratio * sin_t;
    const realw square = 1.0f - sin_off * sin_off;
    const realw cos_off = square_root(square > 1e-12f ? square : (realw)(1e-12f));
    const realw weight = choose(d.around, (realw)(1.0f), d.ratio * cos_t / cos_off);
    return weight * slice(l, d, choose(d.around, cos_t, cos_off), choose(d.around, sin_t, sin_off),
                          clipped);
}

/* Nodes of the quadratures: CLR_PLAIN of the midpoint rule, CLR_EDGE of the Gauss-Legendre rule, and CLR_FINE of both
 * for discs that are large, or more than a quarter as wide as the lobe. Lanes with fewer nodes have weight 0 for the
 * rest, so that no lane depends on its neighbours. rule: (CLR_EDGE + CLR_FINE, 2), -cos tau and weight. */
static inline realw piece(const lobe l, const disc d, realw from, realw to, intw clipped,
                          intw fine, __global const float *rule) {
    const realw middle = 0.5f * (from + to), half_width = 0.5f * (to - from);
    const int nodes = ANYW(fine) ? CLR_FINE : CLR_EDGE;
    realw sum = (realw)(0.0f);
    for (int i = 0; i < nodes; ++i) {
        __global const float *many = rule + 2 * (CLR_EDGE + i), *few = rule + 2 * (i % CLR_EDGE);
        const realw at = choose(fine, (realw)(many[0]), (realw)(few[0]));
        const realw weight = choose(fine, (realw)(many[1]), (realw)(i < CLR_EDGE ? few[1] : 0.0f));
        sum += weight * at_angle(l, d, middle + half_width * at, clipped);
    }
    return sum * half_width;
}

static inline realw midpoint(const lobe l, const disc d, realw whole, intw clipped, intw fine) {
    const realw count = choose(fine, (realw)((float)CLR_FINE), (realw)((float)CLR_PLAIN));
    const realw step = 2.0f * whole / count;
    const int nodes = ANYW(fine) ? CLR_FINE : CLR_PLAIN;
    realw sum = (realw)(0.0f);
    for (int i = 0; i < nodes; ++i) {
        const realw at = (realw)((float)i + 0.5f);
        const realw value = at_angle(l, d, step * at - whole, clipped);
        sum += choose(at < count, value, (realw)(0.0f));
    }
    return sum * step;
}

/* max(0, n.t_d) s^2 / |w.t_d| of one sheet at w, times alpha^2; w_n = w.n. */
static inline realw sheet_density(const lobe l, realw w_n, realw s, realw inverse_root) {
    const realw facing = s * w_n - l.k * l.n_z;
    return choose((facing > 0.0f) & (s > 0.0f), facing * s * s * inverse_root, (realw)(0.0f));
}

static inline realw direction_density(const lobe l, realw w_z, realw w_n, realw root) {
    const realw along = l.k * w_z, inverse_root = 1.0f / root;
    realw sum = sheet_density(l, w_n, along + root, inverse_root);
    if (l.any_two)
        sum += choose(l.two, sheet_density(l, w_n, along - root, inverse_root), (realw)(0.0f));
    return sum;
}

static inline realw sheet_root(const lobe l, realw w_x) {
    const realw square = (l.alpha - l.k * w_x) * (l.alpha + l.k * w_x);
    return square_root(square > 1e-12f ? square : (realw)(1e-12f));
}

/* P of a disc on which the density is smooth: four directions at cos delta = (1 + cos theta) / 2, towards t_m, away
 * from it and to both sides, which is exact for a density of degree 3. */
static inline realw smooth_probability(const lobe l, const disc d) {
    const realw near = 0.5f * (1.0f + d.cosine);
    const realw out = square_root((1.0f - near) * (1.0f + near));
    realw w_z = near * d.z - out * d.rho, w_x = near * d.rho + out * d.z;
    realw sum = direction_density(l, w_z, l.n_z * w_z + l.n_x * d.cos_psi * w_x, sheet_root(l, w_x));
    w_z = near * d.z + out * d.rho;
    w_x = near * d.rho - out * d.z;
    sum += direction_density(l, w_z, l.n_z * w_z + l.n_x * d.cos_psi * w_x, sheet_root(l, w_x));
    w_z = near * d.z;
    const realw root = sheet_root(l, square_root((1.0f - w_z) * (1.0f + w_z)));
    const realw w_n = l.n_z * w_z + l.n_x * d.cos_psi * (near * d.rho), aside = l.n_x * d.sin_psi * out;
    sum += direction_density(l, w_z, w_n + aside, root);
    sum += direction_density(l, w_z, w_n - aside, root);
    return sum * (d.sine * d.sine / ((2.0f * l.alpha * l.alpha) * (1.0f + d.cosine)));
}

/* Whether the density is smooth on a disc: the lobe's edge is at least 1.5 disc radii away from the centre, the
 * horizon of n on both sheets 1.2 (the sheet is s / root times as long as w on it), and that of the face 1. */
static inline intw is_smooth(const lobe l, const disc d, realw height) {
    const realw root = sheet_root(l, d.rho), along = l.k * d.z;
    const realw w_n = l.n_z * d.z + l.n_x * d.cos_psi * d.rho;
    const realw reach = 1.2f * l.alpha * d.sine;
    realw s = along + root, facing = (s * w_n - l.k * l.n_z) * root;
    intw smooth = (d.sine < 0.15f) & (height > d.sine);
    smooth &= (facing > reach * s) | (facing < -reach * s);
    if (l.any_two) {
        s = along - root;
        facing = (s * w_n - l.k * l.n_z) * root;
        const intw both = ((facing > reach * s) | (facing < -reach * s)) &
                          (d.rho + 1.5f * d.sine < l.edge) & (d.z > 0.0f);
        smooth &= both | !l.two;
    }
    return smooth;
}

/* How the lobe's edge lies to a disc. */
typedef struct {
    realw sine, cosine; /* of the azimuth psi* at which its circle meets the disc's */
    intw cut;
    intw outer;         /* cut, and parts of the disc are inside the edge on both sides of the cut */
    intw apart;         /* all of the disc is outside */
} edge_cut;

static inline edge_cut cut_of(const lobe l, const disc d) {
    /* cos psi* is cos theta - cos beta_c cos beta_m over sin beta_c sin beta_m, the cosines as 1 - versine, whose
     * difference does not cancel. */
    edge_cut c;
    const realw versine = d.sine * d.sine / (1.0f + d.cosine);
    const realw versine_c = d.z > 0.0f ? d.rho * d.rho / (1.0f + d.z) : 1.0f - d.z;
    const realw versine_m = l.edge * l.edge / (1.0f + l.edge_cos);
    const realw above = versine_c + versine_m - versine_c * versine_m - versine;
    const realw below = d.rho * l.edge;
    const intw edged = l.two & !d.inside;
    c.cut = (above < below) & (above > -below) & edged;
    c.apart = (above >= below) & (d.rho * l.edge_cos > d.z * l.edge) & edged;
    c.cosine = choose(c.cut, above / (below + 1e-30f), (realw)(0.0f));
    const realw sine_square = 1.0f - c.cosine * c.cosine;
    c.sine = square_root(sine_square > 0.0f ? sine_square : (realw)(0.0f));
    /* Beyond the cut the chords end before the edge if the tangent from t_m to the disc does. */
    c.outer = c.cut & (d.around | (d.z > l.edge_cos * d.cosine));
    return c;
}

/* P of any discs by slices. */
static inline realw sliced_probability(const lobe l, const disc d, intw clipped,
                                 __global const float *rule) {
    const intw fine = (d.sine > 0.15f) | ((4.0f * d.sine > l.edge) & l.two);
    const realw whole = choose(d.around, (realw)(PI_F), (realw)(0.5f * PI_F));
    realw cut_at = whole;
    intw cut = whole < 0.0f; /* none */
    intw outer = cut, apart = cut;
    if (l.any_two) {
        const edge_cut c = cut_of(l, d);
        cut = c.cut;
        outer = c.outer;
        apart = c.apart;
        const realw part = lesser(c.sine / d.ratio, (realw)(1.0f));
        const realw rest = square_root(1.0f - part * part);
        cut_at = choose(cut, angle(choose(d.around, c.sine, part), choose(d.around, c.cosine, rest)), whole);
    }
    realw sum = (realw)(0.0f);
    const intw plain = !(cut | apart);
    if (ANYW(plain)) sum = choose(plain, midpoint(l, d, whole, clipped, fine), sum);
    if (ANYW(cut)) {
        realw total = piece(l, d, -cut_at, cut_at, clipped, fine, rule);
        if (ANYW(outer)) {
            const realw right = piece(l, d, cut_at, whole, clipped, fine, rule);
            const realw left = piece(l, d, -whole, -cut_at, clipped, fine, rule);
            total += choose(outer, left + right, (realw)(0.0f));
        }
        sum = choose(cut, total, sum);
    }
    return sum * (1.0f / PI_F);
}
