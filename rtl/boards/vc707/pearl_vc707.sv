// SPDX-License-Identifier: MIT
// The design on a Xilinx VC707: behind the XDMA core, PCIe 2.0 x8, clocked with 125 MHz.
//
// The cores pearl_xdma and pearl_upsizer are Vivado's, made by build.tcl; so are the primitives. The
// XDMA core masters 128 bits at 250 MHz; the upsizer makes 256 bits at the design's clock of it, the
// same bytes a second.
module pearl_vc707 (
    input  logic       pcie_clk_p,
    input  logic       pcie_clk_n,
    input  logic       pcie_perst_n,
    input  logic [7:0] pcie_rx_p,
    input  logic [7:0] pcie_rx_n,
    output logic [7:0] pcie_tx_p,
    output logic [7:0] pcie_tx_n,
    // 0: the link is up. 1: out of reset. 2: a step has ended.
    output logic [2:0] led
);

  localparam int unsigned LINK_BITS = 128;
  localparam int unsigned DATA_WL = 256;
  // Far more than any map has, so that no address comes round again.
  localparam int unsigned ADDR_BITS = 32;
  localparam int unsigned ID_BITS = 4;

  // Cores and primitives have outputs that nobody needs here.
  // verilator lint_off PINCONNECTEMPTY

  logic pcie_clk, perst_n;
  IBUFDS_GTE2 u_pcie_clk_buffer (
      .I    (pcie_clk_p),
      .IB   (pcie_clk_n),
      .CEB  (1'b0),
      .O    (pcie_clk),
      .ODIV2()
  );
  IBUF u_perst_buffer (
      .I(pcie_perst_n),
      .O(perst_n)
  );

  // ---- The link: XDMA's clock and bus ----

  logic axi_clk, axi_rst_n, link_up, irq_req, irq_ack;

  logic [ID_BITS-1:0] link_awid, link_bid, link_arid, link_rid;
  logic [63:0] link_awaddr, link_araddr;
  logic [7:0] link_awlen, link_arlen;
  logic [2:0] link_awsize, link_arsize, link_awprot, link_arprot;
  logic [1:0] link_awburst, link_arburst, link_bresp, link_rresp;
  logic [3:0] link_awcache, link_arcache;
  logic [LINK_BITS-1:0] link_wdata, link_rdata;
  logic [LINK_BITS/8-1:0] link_wstrb;
  logic link_awlock, link_awvalid, link_awready, link_arlock, link_arvalid, link_arready;
  logic link_wlast, link_wvalid, link_wready, link_bvalid, link_bready;
  logic link_rlast, link_rvalid, link_rready;

  // The map ends far below 2 GiB, and what lies there is refused. So is what lies above 4 GiB, if its
  // address has the highest bit that the design takes.
  logic [ADDR_BITS-1:0] near_awaddr, near_araddr;
  assign near_awaddr = {|link_awaddr[63:ADDR_BITS-1], link_awaddr[ADDR_BITS-2:0]};
  assign near_araddr = {|link_araddr[63:ADDR_BITS-1], link_araddr[ADDR_BITS-2:0]};

  pearl_xdma u_xdma (
      .sys_clk         (pcie_clk),
      .sys_rst_n       (perst_n),
      .user_lnk_up     (link_up),
      .pci_exp_txp     (pcie_tx_p),
      .pci_exp_txn     (pcie_tx_n),
      .pci_exp_rxp     (pcie_rx_p),
      .pci_exp_rxn     (pcie_rx_n),
      .axi_aclk        (axi_clk),
      .axi_aresetn     (axi_rst_n),
      .usr_irq_req     (irq_req),
      .usr_irq_ack     (irq_ack),
      .msi_enable      (),
      .msi_vector_width(),
      .m_axi_awid      (link_awid),
      .m_axi_awaddr    (link_awaddr),
      .m_axi_awlen     (link_awlen),
      .m_axi_awsize    (link_awsize),
      .m_axi_awburst   (link_awburst),
      .m_axi_awprot    (link_awprot),
      .m_axi_awvalid   (link_awvalid),
      .m_axi_awready   (link_awready),
      .m_axi_awlock    (link_awlock),
      .m_axi_awcache   (link_awcache),
      .m_axi_wdata     (link_wdata),
      .m_axi_wstrb     (link_wstrb),
      .m_axi_wlast     (link_wlast),
      .m_axi_wvalid    (link_wvalid),
      .m_axi_wready    (link_wready),
      .m_axi_bid       (link_bid),
      .m_axi_bresp     (link_bresp),
      .m_axi_bvalid    (link_bvalid),
      .m_axi_bready    (link_bready),
      .m_axi_arid      (link_arid),
      .m_axi_araddr    (link_araddr),
      .m_axi_arlen     (link_arlen),
      .m_axi_arsize    (link_arsize),
      .m_axi_arburst   (link_arburst),
      .m_axi_arprot    (link_arprot),
      .m_axi_arvalid   (link_arvalid),
      .m_axi_arready   (link_arready),
      .m_axi_arlock    (link_arlock),
      .m_axi_arcache   (link_arcache),
      .m_axi_rid       (link_rid),
      .m_axi_rdata     (link_rdata),
      .m_axi_rresp     (link_rresp),
      .m_axi_rlast     (link_rlast),
      .m_axi_rvalid    (link_rvalid),
      .m_axi_rready    (link_rready)
  );

  // ---- The design's clock: half of the link's, since 250 MHz is more than its logic does ----

  logic core_clk, core_clk_unbuffered, feedback, locked, core_rst_n;

  // 250 MHz * 4 / 8.
  PLLE2_BASE #(
      .CLKIN1_PERIOD (4),
      .CLKFBOUT_MULT (4),
      .CLKOUT0_DIVIDE(8)
  ) u_pll (
      .CLKIN1  (axi_clk),
      .CLKFBIN (feedback),
      .CLKFBOUT(feedback),
      .CLKOUT0 (core_clk_unbuffered),
      .CLKOUT1 (),
      .CLKOUT2 (),
      .CLKOUT3 (),
      .CLKOUT4 (),
      .CLKOUT5 (),
      .LOCKED  (locked),
      .PWRDWN  (1'b0),
      .RST     (!axi_rst_n)
  );
  BUFG u_core_clk_buffer (
      .I(core_clk_unbuffered),
      .O(core_clk)
  );

  pearl_reset u_reset (
      .clk_i  (core_clk),
      .ready_i(locked),
      .rst_no (core_rst_n)
  );

  // ---- From the link's bus to the design's ----

  logic [ADDR_BITS-1:0] core_awaddr, core_araddr;
  logic [7:0] core_awlen, core_arlen;
  logic [2:0] core_awsize, core_arsize;
  logic [1:0] core_awburst, core_arburst, core_bresp, core_rresp;
  logic [DATA_WL-1:0] core_wdata, core_rdata;
  logic [DATA_WL/8-1:0] core_wstrb;
  logic core_awvalid, core_awready, core_arvalid, core_arready;
  logic core_wlast, core_wvalid, core_wready, core_bvalid, core_bready;
  logic core_rlast, core_rvalid, core_rready;

  pearl_upsizer u_upsizer (
      .s_axi_aclk    (axi_clk),
      .s_axi_aresetn (axi_rst_n),
      .s_axi_awid    (link_awid),
      .s_axi_awaddr  (near_awaddr),
      .s_axi_awlen   (link_awlen),
      .s_axi_awsize  (link_awsize),
      .s_axi_awburst (link_awburst),
      .s_axi_awlock  (link_awlock),
      .s_axi_awcache (link_awcache),
      .s_axi_awprot  (link_awprot),
      .s_axi_awregion('0),
      .s_axi_awqos   ('0),
      .s_axi_awvalid (link_awvalid),
      .s_axi_awready (link_awready),
      .s_axi_wdata   (link_wdata),
      .s_axi_wstrb   (link_wstrb),
      .s_axi_wlast   (link_wlast),
      .s_axi_wvalid  (link_wvalid),
      .s_axi_wready  (link_wready),
      .s_axi_bid     (link_bid),
      .s_axi_bresp   (link_bresp),
      .s_axi_bvalid  (link_bvalid),
      .s_axi_bready  (link_bready),
      .s_axi_arid    (link_arid),
      .s_axi_araddr  (near_araddr),
      .s_axi_arlen   (link_arlen),
      .s_axi_arsize  (link_arsize),
      .s_axi_arburst (link_arburst),
      .s_axi_arlock  (link_arlock),
      .s_axi_arcache (link_arcache),
      .s_axi_arprot  (link_arprot),
      .s_axi_arregion('0),
      .s_axi_arqos   ('0),
      .s_axi_arvalid (link_arvalid),
      .s_axi_arready (link_arready),
      .s_axi_rid     (link_rid),
      .s_axi_rdata   (link_rdata),
      .s_axi_rresp   (link_rresp),
      .s_axi_rlast   (link_rlast),
      .s_axi_rvalid  (link_rvalid),
      .s_axi_rready  (link_rready),
      .m_axi_aclk    (core_clk),
      .m_axi_aresetn (core_rst_n),
      .m_axi_awaddr  (core_awaddr),
      .m_axi_awlen   (core_awlen),
      .m_axi_awsize  (core_awsize),
      .m_axi_awburst (core_awburst),
      .m_axi_awlock  (),
      .m_axi_awcache (),
      .m_axi_awprot  (),
      .m_axi_awregion(),
      .m_axi_awqos   (),
      .m_axi_awvalid (core_awvalid),
      .m_axi_awready (core_awready),
      .m_axi_wdata   (core_wdata),
      .m_axi_wstrb   (core_wstrb),
      .m_axi_wlast   (core_wlast),
      .m_axi_wvalid  (core_wvalid),
      .m_axi_wready  (core_wready),
      .m_axi_bresp   (core_bresp),
      .m_axi_bvalid  (core_bvalid),
      .m_axi_bready  (core_bready),
      .m_axi_araddr  (core_araddr),
      .m_axi_arlen   (core_arlen),
      .m_axi_arsize  (core_arsize),
      .m_axi_arburst (core_arburst),
      .m_axi_arlock  (),
      .m_axi_arcache (),
      .m_axi_arprot  (),
      .m_axi_arregion(),
      .m_axi_arqos   (),
      .m_axi_arvalid (core_arvalid),
      .m_axi_arready (core_arready),
      .m_axi_rdata   (core_rdata),
      .m_axi_rresp   (core_rresp),
      .m_axi_rlast   (core_rlast),
      .m_axi_rvalid  (core_rvalid),
      .m_axi_rready  (core_rready)
  );

  // ---- The design ----

  logic irq;
  logic [ID_BITS-1:0] unused_bid, unused_rid;

  pearl_top #(
      .N_ENVS(pearl_build_pkg::N_ENVS),
      .PE_NUM(pearl_build_pkg::PE_NUM),
      .DATA_WL(DATA_WL),
      .ADDR_BITS(ADDR_BITS)
  ) u_pearl (
      .clk_i        (core_clk),
      .rst_ni       (core_rst_n),
      .irq_o        (irq),
      .s_axi_awid   ('0),
      .s_axi_awaddr (core_awaddr),
      .s_axi_awlen  (core_awlen),
      .s_axi_awsize (core_awsize),
      .s_axi_awburst(core_awburst),
      .s_axi_awvalid(core_awvalid),
      .s_axi_awready(core_awready),
      .s_axi_wdata  (core_wdata),
      .s_axi_wstrb  (core_wstrb),
      .s_axi_wlast  (core_wlast),
      .s_axi_wvalid (core_wvalid),
      .s_axi_wready (core_wready),
      .s_axi_bid    (unused_bid),
      .s_axi_bresp  (core_bresp),
      .s_axi_bvalid (core_bvalid),
      .s_axi_bready (core_bready),
      .s_axi_arid   ('0),
      .s_axi_araddr (core_araddr),
      .s_axi_arlen  (core_arlen),
      .s_axi_arsize (core_arsize),
      .s_axi_arburst(core_arburst),
      .s_axi_arvalid(core_arvalid),
      .s_axi_arready(core_arready),
      .s_axi_rid    (unused_rid),
      .s_axi_rdata  (core_rdata),
      .s_axi_rresp  (core_rresp),
      .s_axi_rlast  (core_rlast),
      .s_axi_rvalid (core_rvalid),
      .s_axi_rready (core_rready)
  );

  pearl_xdma_irq u_irq (
      .clk_i        (axi_clk),
      .rst_ni       (axi_rst_n),
      .irq_i        (irq),
      .usr_irq_req_o(irq_req),
      .usr_irq_ack_i(irq_ack)
  );

  assign led = {irq, core_rst_n, link_up};

endmodule
