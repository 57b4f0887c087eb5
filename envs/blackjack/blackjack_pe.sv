// The core of Blackjack: step.py in hardware. Pipelined, a slot a cycle.
//
// Every stage of the first half takes one more digit from the random numbers, every stage of the
// second deals one more card to the dealer, whether he wants it or not.

// verilator lint_off DECLFILENAME
package blackjack_pkg;
  // verilator lint_on DECLFILENAME

  // Cards of a start, and cards that a dealer draws at most.
  localparam int unsigned DEALT = 4;
  localparam int unsigned MOST_DRAWN = 10;

  // Digits of the start, start, dealer's two cards, his further cards, outcome.
  localparam int unsigned LATENCY = DEALT + 1 + 1 + MOST_DRAWN + 1;
  localparam int unsigned II = 1;

  localparam int unsigned STATE_BITS = 15;
  localparam int unsigned ACTION_BITS = 1;
  localparam int unsigned OBS_BITS = 10;
  localparam int unsigned REWARD_BITS = 2;

  // What a card counts: 1 to 10, or 0 for no card.
  typedef logic [3:0] card_t;

  typedef struct packed {
    // The player still has the ace and the ten of a start.
    logic       natural;
    card_t      hidden;
    card_t      showing;
    // An ace of the player's counts 11.
    logic       ace;
    logic [4:0] player;
  } state_t;

  // A hand whose aces all count 1, and whether there is one.
  typedef struct packed {
    logic       ace;
    logic [4:0] least;
  } hand_t;

  localparam logic [1:0] WIN = 2'd2;
  localparam logic [1:0] NATURAL_WIN = 2'd3;
  localparam logic [4:0] STANDS_ON = 5'd17;

  // Ace, 2 to 10, jack, queen and king.
  function automatic card_t value(logic [3:0] rank);
    return rank > 4'd9 ? 4'd10 : rank + 4'd1;
  endfunction

  function automatic hand_t add(hand_t hand, card_t card);
    return '{ace: hand.ace | card == 4'd1, least: hand.least + {1'b0, card}};
  endfunction

  // An ace counts 11 where that is not too much.
  function automatic logic usable(hand_t hand);
    return hand.ace & hand.least <= 5'd11;
  endfunction

  function automatic logic [4:0] total(hand_t hand);
    return hand.least + (usable(hand) ? 5'd10 : 5'd0);
  endfunction

endpackage

module blackjack_pe
  import blackjack_pkg::*;
#(
    // Whether a win with a natural is a category of its own.
    parameter bit NATURAL_PAYS = 1'b0,
    // Whether a natural wins against all but a natural.
    parameter bit NATURAL_WINS = 1'b1
) (
    input logic               clk_i,
    input logic               rst_ni,
    input logic               valid_i,
    // Start from an initial state, not from state_i.
    input logic               first_i,
    // Do not step: the result is the state started from and its observation.
    input logic               hold_i,
    input state_t             state_i,
    // 0 to stick, 1 to hit.
    input logic               action_i,
    // The random draws of this slot and step, the one for the initial state first.
    input logic   [2:0][31:0] rng_i,

    output logic         valid_o,
    output state_t       state_o,
    output logic   [9:0] obs_o,
    // 0 for a loss, 1 for none and for a draw, 2 for a win, 3 for a win with a natural that pays.
    output logic   [1:0] reward_o,
    output logic         terminated_o
);

  // The numbers whose digits to the base of 13 the cards are, without their first digits so far.
  localparam int unsigned FRACTION = 60;

  // A card, and how many cycles it waits for its turn.
  localparam int unsigned DRAWN_WAIT = DEALT + 2;
  card_t [DEALT-1:0] dealt;
  card_t [MOST_DRAWN-1:0] drawn;

  for (genvar k = 0; k < DEALT; k++) begin : gen_dealt
    logic [31:0] number, number_q;
    logic [35:0] product;
    if (k == 0) begin : gen_first
      assign number = rng_i[0];
    end else begin : gen_next
      assign number = gen_dealt[k-1].number_q;
    end
    assign product = {1'b0, number, 3'b000} + {2'b00, number, 2'b00} + {4'b0000, number};
    card_t [DEALT-1-k:0] card_q;
    always_ff @(posedge clk_i) begin
      number_q  <= product[31:0];
      card_q[0] <= value(product[35:32]);
      for (int unsigned i = 1; i < DEALT - k; i++) card_q[i] <= card_q[i-1];
    end
    if (k == DEALT - 1) begin : gen_last
      logic unused_number;
      assign unused_number = ^number_q;
    end
    assign dealt[k] = card_q[DEALT-1-k];
  end

  for (genvar k = 0; k < MOST_DRAWN; k++) begin : gen_drawn
    logic [FRACTION-1:0] number, number_q;
    logic [FRACTION+3:0] product;
    if (k == 0) begin : gen_first
      logic [3:0] unused_rng;
      assign {number, unused_rng} = {rng_i[1], rng_i[2]};
    end else begin : gen_next
      assign number = gen_drawn[k-1].number_q;
    end
    assign product = {1'b0, number, 3'b000} + {2'b00, number, 2'b00} + {4'b0000, number};
    card_t [DRAWN_WAIT-1:0] card_q;
    always_ff @(posedge clk_i) begin
      number_q <= product[FRACTION-1:0];
      card_q   <= {card_q[DRAWN_WAIT-2:0], value(product[FRACTION+3:FRACTION])};
    end
    if (k == MOST_DRAWN - 1) begin : gen_last
      logic unused_number;
      assign unused_number = ^number_q;
    end
    assign drawn[k] = card_q[DRAWN_WAIT-1];
  end

  // Where the slot starts from.
  state_t [DEALT-1:0] state_q;
  logic   [DEALT-1:0] first_q;
  logic   [  DEALT:0] hit_q;
  logic   [DEALT+1:0] hold_q;
  state_t start, from_q;
  hand_t player;

  assign player = add(add('0, dealt[2]), dealt[3]);
  assign start = '{
          player: total(player),
          ace: usable(player),
          showing: dealt[0],
          hidden: dealt[1],
          natural: total(player) == 5'd21
      };

  always_ff @(posedge clk_i) begin
    state_q <= {state_q[DEALT-2:0], state_i};
    first_q <= {first_q[DEALT-2:0], first_i};
    hit_q   <= {hit_q[DEALT-1:0], action_i};
    hold_q  <= {hold_q[DEALT:0], hold_i};
    from_q  <= first_q[DEALT-1] ? start : state_q[DEALT-1];
  end

  // The dealer's cards, one by one; the first goes to the player as well, if he hits.
  typedef struct packed {
    state_t state;
    hand_t  dealer;
    logic   outright;
    logic   hit;
  } table_t;

  table_t [MOST_DRAWN:0] table_q;

  always_ff @(posedge clk_i) begin
    table_q[0].state <= from_q;
    table_q[0].dealer <= add(add('0, from_q.showing), from_q.hidden);
    table_q[0].outright <= 1'b0;
    table_q[0].hit <= hit_q[DEALT] & !hold_q[DEALT];
  end

  for (genvar k = 0; k < MOST_DRAWN; k++) begin : gen_deal
    table_t table_d;
    logic   draws;
    assign draws = total(table_q[k].dealer) < STANDS_ON;
    if (k == 0) begin : gen_player
      hand_t hand;
      assign hand = add(
          '{
              ace: table_q[k].state.ace,
              least: table_q[k].state.player - (table_q[k].state.ace ? 5'd10 : 5'd0)
          },
          table_q[k].hit ? drawn[k] : '0
      );
      always_comb begin
        table_d = table_q[k];
        if (draws) table_d.dealer = add(table_q[k].dealer, drawn[k]);
        if (!hold_q[DEALT+1]) begin
          table_d.state.player = total(hand);
          table_d.state.ace = usable(hand);
        end
        // No card beats a natural of the dealer's, and he takes none.
        table_d.outright = NATURAL_WINS & table_q[k].state.natural & total(table_q[k].dealer) != 5'd21;
      end
    end else begin : gen_dealer
      always_comb begin
        table_d = table_q[k];
        if (draws) table_d.dealer = add(table_q[k].dealer, drawn[k]);
      end
    end
    always_ff @(posedge clk_i) table_q[k+1] <= table_d;
  end

  // The outcome.
  table_t last;
  logic bust, won, drew;
  logic [4:0] dealer;
  logic [1:0] stuck;

  assign last = table_q[MOST_DRAWN];
  assign bust = last.state.player > 5'd21;
  assign dealer = total(last.dealer) > 5'd21 ? 5'd0 : total(last.dealer);
  assign won = last.outright | last.state.player > dealer;
  assign drew = last.state.player == dealer;
  always_comb begin
    stuck = {1'b0, drew};
    if (won) stuck = NATURAL_PAYS & last.state.natural ? NATURAL_WIN : WIN;
  end

  always_ff @(posedge clk_i) begin
    state_o <= last.state;
    state_o.natural <= last.state.natural & !last.hit;
    obs_o <= {last.state.ace, last.state.showing, last.state.player};
    reward_o <= last.hit ? {1'b0, !bust} : stuck;
    terminated_o <= bust | !last.hit;
  end

  logic [LATENCY-1:0] valid_q;
  always_ff @(posedge clk_i or negedge rst_ni) begin
    if (!rst_ni) valid_q <= '0;
    else valid_q <= {valid_q[LATENCY-2:0], valid_i};
  end
  assign valid_o = valid_q[LATENCY-1];

endmodule
